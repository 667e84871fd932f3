"""Searches over sets of measurement times, each an ask-and-tell optimiser.

Here only NumPy: an optimiser never evaluates anything and keeps no generator; its state is
explicit and its choices come from the generator it is handed.
"""

from pfdist.search.base import Optimiser
from pfdist.search.genetic import GeneticAlgorithm
from pfdist.search.random_trials import RandomTrials

__all__ = ["GeneticAlgorithm", "Optimiser", "RandomTrials"]
