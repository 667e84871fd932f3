"""Searches over sets of measurement times, each an ask-and-tell optimiser.

Here only NumPy: an optimiser never evaluates anything and keeps no generator; its state is
explicit and its choices come from the generator it is handed.
"""

from pfdist.search.annealing import Annealing
from pfdist.search.base import Candidate, Optimiser, SearchOptimiser
from pfdist.search.budgets import Budgets
from pfdist.search.cross_entropy import CrossEntropy
from pfdist.search.exchange import Exchange
from pfdist.search.exhaustive import Exhaustive
from pfdist.search.genetic import GeneticAlgorithm
from pfdist.search.greedy import GreedyBackward, GreedyForward
from pfdist.search.race import Race
from pfdist.search.random_trials import RandomTrials
from pfdist.search.survivors import Survivors
from pfdist.search.trust import Probe

__all__ = [
    "Annealing",
    "Budgets",
    "Candidate",
    "CrossEntropy",
    "Exchange",
    "Exhaustive",
    "GeneticAlgorithm",
    "GreedyBackward",
    "GreedyForward",
    "Optimiser",
    "Probe",
    "Race",
    "RandomTrials",
    "SearchOptimiser",
    "Survivors",
]
