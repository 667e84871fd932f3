/* The bootstrap filter of the univariate nonlinear growth model, with the arithmetic and the arrays
of pfdist's kernel, and a bare loop with the same noise and memory traffic.

pfdist/kernels/ explains each step. Sums, products and fused operations stand in the kernel's order,
so both programs give the same MSE but for the rounding of sines and cosines, which the caller
passes. The number of particles P is at most MOST. */

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

enum { LANES = 16, TILE = 64, SUMS = 64, MOST = 8192, SPARE = 48, LENGTH = MOST + TILE + SPARE };
enum { FILTER_INITIAL = 3, FILTER_PROCESS = 4, RESAMPLING = 5 };

#define ALIGNED __attribute__((aligned(64)))
#define INLINE static inline __attribute__((always_inline))

typedef uint32_t words __attribute__((vector_size(4 * LANES), aligned(4)));

static ALIGNED double cloud[2][LENGTH], log_weight[LENGTH], cumulative[LENGTH], sums[LENGTH];
static ALIGNED float noise[LENGTH], weights[2][LENGTH];
static ALIGNED uint32_t points[LENGTH], shares[LENGTH], ancestor[LENGTH];
static double *const terms = log_weight;

typedef struct {
    uint32_t low, high, draw;
} Key;

/* --- noise ------------------------------------------------------------------------------------ */

INLINE uint32_t rotated(uint32_t x, int bits) { return x << bits | x >> (32 - bits); }

INLINE void cipher(Key key, uint32_t t, uint32_t block, uint32_t role, uint32_t x[4]) {
    static const int turns[13][2] = {{10, 26}, {11, 21}, {13, 27}, {23, 5},  {6, 20},
                                     {17, 11}, {25, 10}, {18, 20}, {10, 26}, {11, 21},
                                     {13, 27}, {23, 5},  {6, 20}};
    const uint32_t k[5] = {key.low, key.high, key.draw, t,
                           0x1BD11BDA ^ key.low ^ key.high ^ key.draw ^ t};
    uint32_t a = block + k[0], b = k[1], c = role + k[2], d = k[3];
#pragma GCC unroll 13
    for (int round = 0; round < 13; round++) {
        if (round && round % 4 == 0) {
            int times = round / 4;
            a += k[times % 5], b += k[(times + 1) % 5], c += k[(times + 2) % 5];
            d += k[(times + 3) % 5] + times;
        }
        a += b, c += d;
        uint32_t other = rotated(d, turns[round][1]) ^ c;
        d = rotated(b, turns[round][0]) ^ a, b = other;
    }
    x[0] = a, x[1] = d, x[2] = c, x[3] = b; /* the last round does not permute */
}

INLINE float fused(float a, float b, float c) { return __builtin_fmaf(a, b, c); }

INLINE int32_t bits_of(float x) {
    int32_t bits;
    memcpy(&bits, &x, 4);
    return bits;
}

INLINE float float_of(int32_t bits) {
    float x;
    memcpy(&x, &bits, 4);
    return x;
}

INLINE float exponential(uint32_t word) {
    float less = 0x1p-32f * (1.0f - 0x1p-24f), u = fused((float)word, less, 0x1p-33f);
    int32_t bits = bits_of(u), exponent = (bits - 0x3F3504F3) >> 23;
    float f = float_of(bits - exponent * (1 << 23)) - 1.0f, p = -0.08533313f;
    p = fused(p, f, 0.14269258f);
    p = fused(p, f, -0.14977401f);
    p = fused(p, f, 0.16577993f);
    p = fused(p, f, -0.19955933f);
    p = fused(p, f, 0.25001353f);
    p = fused(p, f, -0.33334193f);
    p = fused(p, f, 0.49999997f);
    p = fused(p, f, -1.0f);
    return fused(p, f, (float)exponent * -0.69314718f);
}

INLINE float uniform(uint32_t word) { return ((float)(word >> 9) + 0.5f) * 0x1p-23f; }

INLINE void normals(uint32_t word_a, uint32_t word_b, float *first, float *second) {
    float radius = __builtin_sqrtf(2.0f * exponential(word_a));
    float s = (float)(int32_t)word_b * 0x1p-31f, q = s * s, p = -3.8589476e-04f;
    p = fused(p, q, 6.8600797e-03f);
    p = fused(p, q, -7.5187169e-02f);
    p = fused(p, q, 5.2403611e-01f);
    p = fused(p, q, -2.0261195f);
    p = fused(p, q, 3.1415927f);
    *first = radius * (fused(-q, s, s) * p);
    p = -1.6158471e-03f;
    p = fused(p, q, 2.5015287e-02f);
    p = fused(p, q, -2.2883615e-01f);
    p = fused(p, q, 1.2779757f);
    p = fused(p, q, -3.7392056f);
    p = fused(p, q, 4.0f);
    *second = radius * ((0.25f - q) * p);
}

#define FILL(NAME, FOUR)                                                                       \
    static void NAME(long count, Key key, uint32_t t, uint32_t role) {                         \
        for (long tile = 0; tile < (count + TILE - 1) / TILE; tile++) {                        \
            float *restrict out = __builtin_assume_aligned(noise + tile * TILE, 64);           \
            _Pragma("GCC ivdep") for (long lane = 0; lane < LANES; lane++) {                   \
                uint32_t x[4];                                                                 \
                float a, b, c, d;                                                              \
                cipher(key, t, (uint32_t)(tile * LANES + lane), role, x);                      \
                FOUR out[lane] = a, out[lane + LANES] = b, out[lane + 2 * LANES] = c;          \
                out[lane + 3 * LANES] = d;                                                     \
            }                                                                                  \
        }                                                                                      \
    }

FILL(fill_normals, normals(x[0], x[1], &a, &b); normals(x[2], x[3], &c, &d);)
FILL(fill_exponentials, a = exponential(x[0]); b = exponential(x[1]); c = exponential(x[2]);
     d = exponential(x[3]);)
FILL(fill_uniforms, a = uniform(x[0]); b = uniform(x[1]); c = uniform(x[2]); d = uniform(x[3]);)

/* --- weights ---------------------------------------------------------------------------------- */

INLINE float exp_of(float x) {
    float shifted = fused(x, 1.4426950f, 12582912.0f), k = shifted - 12582912.0f;
    float r = fused(k, 2.12194440e-4f, fused(k, -0.693359375f, x)), p = 1.9875691e-4f;
    p = fused(p, r, 1.3981999e-3f);
    p = fused(p, r, 8.3334519e-3f);
    p = fused(p, r, 4.1665796e-2f);
    p = fused(p, r, 1.6666666e-1f);
    p = fused(p, r, 5.0e-1f);
    p = fused(p, r, 1.0f);
    p = fused(p, r, 1.0f);
    return p * float_of((int32_t)((uint32_t)(bits_of(shifted) + 127) << 23));
}

#define IMPOSSIBLE (-__DBL_MAX__)

static void weigh(long size, float *restrict weight) {
    double highest[LANES];
    for (int lane = 0; lane < LANES; lane++) highest[lane] = log_weight[lane];
    for (long i = LANES; i < size; i += LANES)
        for (int lane = 0; lane < LANES; lane++) {
            double value = log_weight[i + lane];
            highest[lane] = highest[lane] > value ? highest[lane] : value;
        }
    double most = highest[0];
    for (int lane = 1; lane < LANES; lane++) most = most > highest[lane] ? most : highest[lane];
    for (long i = 0; i < size; i++) {
        double excess = log_weight[i] - most;
        int possible = (excess > -87.0) & (log_weight[i] > IMPOSSIBLE);
        float value = exp_of((float)(possible ? excess : 0.0));
        weight[i] = possible ? value : 0.0f;
    }
}

static double cumulate(const float *restrict values, long count, double *restrict out) {
    long stretch = count / 4;
    double a = 0.0, b = 0.0, c = 0.0, d = 0.0;
    for (long i = 0; i < stretch; i++) {
        out[i] = a += values[i];
        out[stretch + i] = b += values[stretch + i];
        out[2 * stretch + i] = c += values[2 * stretch + i];
        out[3 * stretch + i] = d += values[3 * stretch + i];
    }
    double before = a, totals[3] = {b, c, d};
    for (int chain = 1; chain < 4; chain++) {
        for (long i = chain * stretch; i < (chain + 1) * stretch; i++) out[i] += before;
        before += totals[chain - 1];
    }
    return before;
}

/* The order of additions is that of `row_sum`. */
static double sum_of(const double *restrict values, long size) {
    double part[SUMS] ALIGNED = {0.0};
    long whole = size / SUMS * SUMS;
    for (long i = 0; i < whole; i += SUMS)
        for (int k = 0; k < SUMS; k++) part[k] += values[i + k];
    for (long i = whole; i < size; i += LANES)
        for (int k = 0; k < LANES; k++) part[k] += values[i + k];
    for (int half = SUMS / 2; half >= 1; half /= 2)
        for (int k = 0; k < half; k++) part[k] += part[k + half];
    return part[0];
}

/* --- resampling ------------------------------------------------------------------------------- */

#define ALL_SHARES (0x1p32 - 0x1p8)

static void merge(long particles, long size, double total) {
    double scale = ALL_SHARES / (total > 1e-100 ? total : 1e-100);
    for (long j = 0; j < particles; j++) shares[j] = (uint32_t)(int64_t)(cumulative[j] * scale);
    for (long j = particles - 1; j < size; j++) shares[j] = 0xFFFFFFFF;
    for (long i = particles; i < size; i++) points[i] = 0xFFFFFFFE;
    memset(ancestor, 0, 4 * LANES);
    size_t first = 0, begin = 0;
    while (begin < (size_t)particles) {
        words here = *(words *)(points + begin), ranks[4] = {*(words *)(ancestor + begin)};
        for (int lane = 0; lane < LANES; lane++) ancestor[begin + LANES + lane] = (uint32_t)first;
#pragma GCC unroll 16
        for (int lane = 0; lane < LANES; lane++) {
            words alike = shares[first + lane] - (words){0};
            ranks[lane % 4] -= (words)(alike <= here);
        }
        *(words *)(ancestor + begin) = ranks[0] + ranks[1] + ranks[2] + ranks[3];
        size_t passed = shares[first + LANES - 1] <= points[begin + LANES - 1];
        first += passed * LANES, begin += (1 - passed) * LANES;
    }
}

static void multinomial(long particles, long size, Key key, uint32_t t) {
    fill_exponentials(particles + 1, key, t, RESAMPLING);
    cumulate(noise, (particles + TILE) / TILE * TILE, sums);
    double scale = ALL_SHARES / sums[particles];
    for (long i = 0; i < particles; i++) points[i] = (uint32_t)(int64_t)(sums[i] * scale);
    merge(particles, size, cumulative[particles - 1]);
}

INLINE float larger(float a, float b) { return a > b ? a : b; }

static void systematic(long particles, Key key, uint32_t t) {
    fill_uniforms(1, key, t, RESAMPLING);
    double shift = noise[0], total = cumulative[particles - 1];
    double scale = particles / (total > 1e-100 ? total : 1e-100);
    for (long j = 0; j < particles; j++) {
        double end = __builtin_ceil(cumulative[j] * scale - shift);
        points[j] = (uint32_t)(int64_t)(end < particles ? end : particles);
    }
    memset(noise, 0, 4 * (particles + 1));
    for (long j = 1; j < particles; j++) noise[points[j - 1]] = (float)(int32_t)j;
    long stretch = particles / 4;
    float *restrict mark = noise, last[4] = {0.0f};
    for (long i = 0; i < stretch; i++)
        for (int chain = 0; chain < 4; chain++) {
            last[chain] = larger(last[chain], mark[chain * stretch + i]);
            mark[chain * stretch + i] = last[chain];
        }
    float before = 0.0f;
    for (int chain = 0; chain < 4; chain++) {
        for (long i = chain * stretch; i < (chain + 1) * stretch; i++)
            ancestor[i] = (uint32_t)larger(mark[i], before);
        before = larger(before, last[chain]);
    }
    for (long i = 4 * stretch; i < particles; i++)
        ancestor[i] = (uint32_t)(before = larger(before, mark[i]));
}

/* --- the filter ------------------------------------------------------------------------------- */

INLINE void repeat_first(long particles, long size) {
    for (long i = particles; i < size; i++) noise[i] = noise[0];
}

/* y, z and mse of the draws; measured, push = 8 cos(1.2 t) and sd of the measurement at each t. */
void filter_draws(long draws, long instants, long particles, uint64_t stream, int is_systematic,
                  const double *y, const double *z, const uint8_t *measured, const double *push,
                  const double *sd, double *mse) {
    long size = (particles + LANES - 1) / LANES * LANES;
    for (long i = 0; i < size; i++) weights[0][i] = i < particles ? 1.0f : 0.0f;
    for (long draw = 0; draw < draws; draw++) {
        Key key = {(uint32_t)stream, (uint32_t)(stream >> 32), (uint32_t)draw};
        int here = 0;
        double error = 0.0;
        fill_normals(particles, key, 0, FILTER_INITIAL);
        repeat_first(particles, size);
        for (long i = 0; i < size; i++) cloud[0][i] = 5.0 * noise[i];
        for (long t = 0; t < instants; t++) {
            if (t > 0) {
                fill_normals(particles, key, (uint32_t)(t - 1), FILTER_PROCESS);
                repeat_first(particles, size);
                const double *restrict from = cloud[here];
                double *restrict to = cloud[1 - here];
                for (long i = 0; i < size; i++) {
                    double x = from[i];
                    to[i] = x / 2 + 25 * x / (1 + x * x) + push[t - 1] + 1.0 * noise[i];
                }
                here = 1 - here;
            }
            const double *restrict x = cloud[here];
            float *restrict weight = weights[0];
            double total = (double)particles;
            if (measured[t]) {
                double observed = y[draw * instants + t], scale = sd[t];
                for (long i = 0; i < size; i++) {
                    double r = (observed - x[i] * x[i] / 20) / scale, value = -0.5 * (r * r);
                    log_weight[i] = __builtin_fabs(value) < __builtin_inf() ? value : IMPOSSIBLE;
                }
                for (long i = particles; i < size; i++) log_weight[i] = IMPOSSIBLE;
                weigh(size, weights[1]);
                weight = weights[1];
                total = cumulate(weight, size, cumulative);
            }
            for (long i = 0; i < size; i++) terms[i] = weight[i] * (weight[i] > 0.0f ? x[i] : 0.0);
            double miss = z[draw * instants + t] - sum_of(terms, size) / total;
            error += miss * miss;
            if (measured[t] && t + 1 < instants) {
                if (is_systematic)
                    systematic(particles, key, (uint32_t)t);
                else
                    multinomial(particles, size, key, (uint32_t)t);
                for (long i = particles; i < size; i++) ancestor[i] = ancestor[0];
                double *restrict to = cloud[1 - here];
                for (long i = 0; i < size; i++) to[i] = x[ancestor[i]];
                here = 1 - here;
            }
        }
        mse[draw] = error / instants;
    }
}

/* The same noise, and each array written and read once where the filter does so. */
void bare_loop(long draws, long instants, long particles, uint64_t stream, int is_systematic,
               const double *y, const double *z, const uint8_t *measured, const double *push,
               const double *sd, double *mse) {
    long size = (particles + LANES - 1) / LANES * LANES;
    (void)y, (void)z, (void)sd;
    for (long i = 0; i < size; i++) cloud[0][i] = 0.0;
    for (long draw = 0; draw < draws; draw++) {
        Key key = {(uint32_t)stream, (uint32_t)(stream >> 32), (uint32_t)draw};
        int here = 0;
        double sum = 0.0;
        for (long t = 0; t < instants; t++) {
            fill_normals(particles, key, (uint32_t)t, FILTER_PROCESS);
            const double *restrict from = cloud[here];
            double *restrict to = cloud[1 - here];
            for (long i = 0; i < size; i++) to[i] = from[i] * 0.5 + noise[i] + push[t];
            here = 1 - here;
            if (measured[t]) {
                for (long i = 0; i < size; i++) log_weight[i] = to[i];
                for (long i = 0; i < size; i++) weights[1][i] = (float)log_weight[i];
                for (long i = 0; i < size; i++) cumulative[i] = weights[1][i];
            }
            for (long i = 0; i < size; i++) terms[i] = to[i];
            sum += sum_of(terms, size);
            if (measured[t] && t + 1 < instants) {
                if (is_systematic)
                    fill_uniforms(1, key, (uint32_t)t, RESAMPLING);
                else {
                    fill_exponentials(particles + 1, key, (uint32_t)t, RESAMPLING);
                    for (long i = 0; i < size; i++) sums[i] = noise[i];
                    for (long i = 0; i < size; i++) points[i] = (uint32_t)(int64_t)sums[i];
                }
                for (long i = 0; i < size; i++) shares[i] = (uint32_t)(int64_t)cumulative[i];
                for (long i = 0; i < size; i++) ancestor[i] = shares[i] ^ points[i];
                double *restrict back = cloud[here], *restrict copy = cloud[1 - here];
                for (long i = 0; i < size; i++) copy[i] = back[i] + ancestor[i] * 0x1p-40;
                here = 1 - here;
            }
        }
        mse[draw] = sum;
    }
}
