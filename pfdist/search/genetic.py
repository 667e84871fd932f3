"""The paper's genetic algorithm (section 2.4).

It does as the paper says. The authors' MATLAB departs from it in ways that are not copied here:

1. it returns the individual at the best cost's index after the population has been replaced by
   its offspring, so an unevaluated one; here it is the best of the last generation that was
   evaluated, with the cost that this very individual got;
2. it gives a degenerate individual the sum of the others' fitness, about half of the selection;
   here it is killed;
3. its defaults are 250 particles and 100 draws; here they are the paper's 500 and 1,000;
4. it evaluates one population more than generations; here as many as generations, the first of
   them random.

Where measurement times are constrained, a child that breaks a constraint is repaired.

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

from pfdist.evaluation.estimate import SearchEvaluation
from pfdist.search.base import Candidate
from pfdist.search.methods import method
from pfdist.search.section import Count, EvaluationSettings, Even, Flag, Positive, Probability
from pfdist.times.feasible import Feasible
from pfdist.times.measurement_times import Times


@dataclass(frozen=True)
class GeneticState:
    """The last population that was evaluated, and how many were.

    Parameters
    ----------
    evaluated_generations : int
    evaluations : tuple of SearchEvaluation
        One an individual, copies repeated.
    """

    evaluated_generations: int = 0
    evaluations: tuple[SearchEvaluation, ...] = ()


@method("genetic", evaluation=EvaluationSettings())
@dataclass(frozen=True)
class GeneticAlgorithm:
    """Genetic algorithm on sets of measurement times.

    Parameters
    ----------
    feasible : Feasible
    population : int
        Even.
    generations : int
        Populations evaluated, the first of them random.
    crossover_probability : float
        Of each pair of parents.
    mutation_probability : float
        Of each gene (measurement time).
    sigma_scaling : float
        An individual whose cost lies this many standard deviations below the mean expects two
        offspring. The paper's sigma coefficient, 1.
    share_copies : bool
        Whether individuals of a generation that are copies of one set share one evaluation. The
        paper evaluates each individual afresh. Sharing saves 4 to 27 % of the work, but an error of
        the shared evaluation counts once for each copy, so that a lucky set takes over the
        population: the sets found cost 0.25 % more.
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
        """How many sets of times it will ask for, copies counted."""
        return self.population * self.generations

    def init(self) -> GeneticState:
        """Give the state before the first asking."""
        return GeneticState()

    def ask(self, state: GeneticState, rng: np.random.Generator) -> list[Candidate]:
        """Give the next population: select, cross over, mutate; the first is random.

        If every individual was killed there are no parents, and the next population is random.
        """
        costs = np.array([evaluation.cost for evaluation in state.evaluations])
        if not np.isfinite(costs).any():
            return self._candidates(self.feasible.random(self.population, rng))
        offspring = expected_offspring(costs, self.sigma_scaling)
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

    def tell(self, state: GeneticState, evaluations: Sequence[SearchEvaluation]) -> GeneticState:
        """Take the evaluated population in the place of the last."""
        return GeneticState(state.evaluated_generations + 1, tuple(evaluations))

    def done(self, state: GeneticState) -> bool:
        """Whether all generations were evaluated."""
        return state.evaluated_generations >= self.generations

    def finalists(self, state: GeneticState) -> list[SearchEvaluation]:
        """Give the best individual of the last generation, as evaluated there."""
        return sorted(state.evaluations, key=lambda evaluation: evaluation.cost)[:1]

    def _candidates(self, population: Sequence[Times]) -> list[Candidate]:
        if self.share_copies:
            return [Candidate(times) for times in population]
        return [Candidate(times, individual=i) for i, times in enumerate(population)]

    def _mutate(self, individual: set[int], rng: np.random.Generator) -> set[int]:
        """Replace each gene, with the mutation probability, by a time that is not in the set."""
        genes = np.array(sorted(individual))
        for gene in genes[rng.random(genes.size) < self.mutation_probability]:
            absent = sorted(set(self.feasible.allowed) - individual)
            if absent:
                individual = (individual - {int(gene)}) | {int(rng.choice(absent))}
        return individual


def expected_offspring(costs: NDArray[np.float64], sigma_scaling: float) -> NDArray[np.float64]:
    """Sigma scaling: max(0, 1 + (mean - cost) / (coefficient * sd)), over the living.

    Parameters
    ----------
    costs : array of float64, (P,)
        An infinite cost marks a killed individual, which expects no offspring.
    sigma_scaling : float

    Returns
    -------
    array of float64, (P,)
        1 for each of the living if all their costs are the same.
    """
    living = np.isfinite(costs)
    mean, sd = np.mean(costs[living]), np.std(costs[living])
    offspring = np.zeros_like(costs)
    # Of equal costs sd may be a rounding, and the mean less than any of them.
    excess = (mean - costs[living]) / (sigma_scaling * sd) if np.ptp(costs[living]) > 0 else 0.0
    offspring[living] = np.maximum(0.0, 1.0 + excess)
    return offspring


def stochastic_universal_sampling(
    expected: NDArray[np.float64], count: int, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Select by one spin of a wheel with equally spaced pointers.

    Parameters
    ----------
    expected : array of float64, (P,)
        Proportional to the offspring expected.
    count : int
        How many are selected.
    rng : numpy.random.Generator

    Returns
    -------
    array of int, (count,)
        Each index floor or ceil of its expected number of times.
    """
    pointers = (np.arange(count) + rng.random()) / count
    wheel = np.cumsum(expected) / np.sum(expected)
    return np.minimum(np.searchsorted(wheel, pointers, side="right"), expected.size - 1)


def count_preserving_crossover(
    a: set[int], b: set[int], rng: np.random.Generator
) -> tuple[set[int], set[int]]:
    """Swap a random number, at least 1, of the elements in which two parents differ.

    Parameters
    ----------
    a, b : set of int
    rng : numpy.random.Generator

    Returns
    -------
    tuple of two sets of int
        Each of its parent's size.
    """
    only_a, only_b = sorted(a - b), sorted(b - a)
    most = min(len(only_a), len(only_b))
    if not most:
        return set(a), set(b)
    swaps = int(rng.integers(1, most, endpoint=True))
    from_a = {int(time) for time in rng.permutation(only_a)[:swaps]}
    from_b = {int(time) for time in rng.permutation(only_b)[:swaps]}
    return (a - from_a) | from_b, (b - from_b) | from_a
