"""The paper's genetic algorithm (section 2.4).

This module follows the paper. The authors' MATLAB code departs from the paper as follows:

1. MATLAB looks up the index of the best error after offspring have replaced the population, so it
   returns an individual that was not evaluated. Here the result is the best individual of the last
   evaluated generation, with the error of this very individual.
2. MATLAB gives a degenerate individual the sum of the fitness of all others, so it gets about half
   of the selection. Here it is killed.
3. The defaults of MATLAB are 250 particles and 100 draws. Here they are the paper's 500 and 1,000.
4. MATLAB evaluates one population more than there are generations. Here every generation is
   evaluated once; the first is random.

If the measurement times are constrained, a child that breaks a constraint is repaired.

References
----------
Mitchell, "An introduction to genetic algorithms", 1998 (stochastic universal sampling, sigma
scaling). Baker, "Reducing bias and inefficiency in the selection algorithm", 1987. Umbarkar and
Sheth, "Crossover operators in genetic algorithms: a review", 2015.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pfdist.common.measurement_times import Times
from pfdist.filters.estimate import Evaluation
from pfdist.problem.feasible import Feasible
from pfdist.problem.methods import method
from pfdist.problem.search_section import (
    Count,
    EvaluationSettings,
    Even,
    Flag,
    Positive,
    Probability,
)
from pfdist.search.base import Candidate


@dataclass(frozen=True)
class GeneticState:
    """The last evaluated population, and the number of evaluated generations."""

    evaluated_generations: int = 0
    evaluations: tuple[Evaluation, ...] = ()  # of each individual, in the order of the population


@method("genetic", evaluation=EvaluationSettings())
@dataclass(frozen=True)
class GeneticAlgorithm:
    """The paper's genetic algorithm: selects, crosses over and mutates a population of sets.

    Parameters
    ----------
    feasible : Feasible
    population : int
        Number of individuals.
    generations : int
        Number of populations that are evaluated. The first is random.
    crossover_probability : float
        Probability that a pair of parents is crossed over.
    mutation_probability : float
        Probability that a gene (a measurement time) mutates.
    sigma_scaling : float
        The paper's sigma coefficient. An individual whose error lies this many standard deviations
        below the mean expects two offspring.
    share_copies : bool
        Whether copies of a set in a generation share one evaluation, not as in the paper: it saves
        4 to 27 % of the work, but found sets are 0.25 % worse.
    """

    feasible: Feasible
    population: Even = 50
    generations: Count = 25
    crossover_probability: Probability = 1.0
    mutation_probability: Probability = 0.003
    sigma_scaling: Positive = 1.0
    share_copies: Flag = False

    @property
    def evaluations(self) -> int:
        """Number of evaluations, copies included."""
        return self.population * self.generations

    def init(self) -> GeneticState:
        """The state before the first generation."""
        return GeneticState()

    def ask(self, state: GeneticState, rng: np.random.Generator) -> list[Candidate]:
        """The next population: selected, crossed over and mutated; the first is random.

        If every individual was killed, the next population is random.
        """
        errors = np.array([evaluation.expected_mse for evaluation in state.evaluations])
        if not np.isfinite(errors).any():
            return self._candidates(self.feasible.random(self.population, rng))
        offspring = expected_offspring(errors, self.sigma_scaling)
        parents = rng.permutation(stochastic_universal_sampling(offspring, self.population, rng))
        population = [state.evaluations[parent].measurement_times for parent in parents]
        children: list[set[int]] = []
        for a, b in zip(population[::2], population[1::2], strict=True):
            if rng.random() < self.crossover_probability:
                children.extend(count_preserving_crossover(set(a), set(b), rng))
            else:
                children.extend([set(a), set(b)])
        mutated = [self._mutate(child, rng) for child in children]
        return self._candidates([self.feasible.repair(child, rng) for child in mutated])

    def tell(self, state: GeneticState, evaluations: Sequence[Evaluation]) -> GeneticState:
        """The next state, with the evaluated population."""
        return GeneticState(state.evaluated_generations + 1, tuple(evaluations))

    def done(self, state: GeneticState) -> bool:
        """Whether all generations were evaluated."""
        return state.evaluated_generations >= self.generations

    def finalists(self, state: GeneticState) -> list[Evaluation]:
        """The best individual of the last generation, with its evaluation there."""
        return sorted(state.evaluations, key=lambda evaluation: evaluation.expected_mse)[:1]

    def _candidates(self, population: Sequence[Times]) -> list[Candidate]:
        if self.share_copies:
            return [Candidate(times) for times in population]
        return [Candidate(times, individual=i) for i, times in enumerate(population)]

    def _mutate(self, individual: set[int], rng: np.random.Generator) -> set[int]:
        """An individual whose genes were replaced, with some probability, by absent times.

        If smaller sets are feasible, a gene may also be removed, or an absent time added.
        """
        genes = np.array(sorted(individual))
        for gene in genes[rng.random(genes.size) < self.mutation_probability]:
            absent = sorted(set(self.feasible.allowed) - individual)
            if absent:
                out, new = {int(gene)}, {int(rng.choice(absent))}
                if self.feasible.smaller:
                    out, new = ((out, new), (out, set[int]()), (set[int](), new))[rng.integers(3)]
                individual = (individual - out) | new
        return individual


def expected_offspring(errors: NDArray[np.float64], sigma_scaling: float) -> NDArray[np.float64]:
    """Expected offspring of each individual: max(0, 1 + (mean - error) / (coefficient * sd)), (P,).

    `sigma_scaling` is the coefficient. An infinite error marks a killed individual, which has no
    offspring and does not count in mean and sd. If all errors are equal, each other individual
    expects one.
    """
    living = np.isfinite(errors)
    mean, sd = np.mean(errors[living]), np.std(errors[living])
    offspring = np.zeros_like(errors)
    # If all errors are equal, rounding may make sd positive, and the mean less than every error.
    excess = (mean - errors[living]) / (sigma_scaling * sd) if np.ptp(errors[living]) > 0 else 0.0
    offspring[living] = np.maximum(0.0, 1.0 + excess)
    return offspring


def stochastic_universal_sampling(
    expected: NDArray[np.float64], count: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Selected indices, (count,): one spin of a wheel with equally spaced pointers.

    Each index occurs floor or ceil of its expected number of times. `expected`, (P,), is
    proportional to the expected offspring.
    """
    pointers = (np.arange(count) + rng.random()) / count
    wheel = np.cumsum(expected) / np.sum(expected)
    return np.minimum(np.searchsorted(wheel, pointers, side="right"), expected.size - 1)


def count_preserving_crossover(
    a: set[int], b: set[int], rng: np.random.Generator
) -> tuple[set[int], set[int]]:
    """Two children: copies of the parents that swap a random number of differing elements.

    At least one element is swapped. Each child has the size of its parent.
    """
    only_a, only_b = sorted(a - b), sorted(b - a)
    most = min(len(only_a), len(only_b))
    if not most:
        return set(a), set(b)
    swaps = int(rng.integers(1, most, endpoint=True))
    from_a = {int(time) for time in rng.permutation(only_a)[:swaps]}
    from_b = {int(time) for time in rng.permutation(only_b)[:swaps]}
    return (a - from_a) | from_b, (b - from_b) | from_a
