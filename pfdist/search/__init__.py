"""Searches over sets of measurement times, each an ask-and-tell optimiser.

An optimiser evaluates nothing itself and owns no random generator. The caller keeps its state and
supplies a generator. This room imports NumPy, but neither Numba nor Ray.
"""

from pfdist.problem.methods import method
from pfdist.problem.search_section import Count
from pfdist.search.base import Candidate, Counted, Optimiser
from pfdist.search.corridor import Corridor
from pfdist.search.exchange import Exchange
from pfdist.search.exhaustive import Exhaustive
from pfdist.search.genetic import GeneticAlgorithm
from pfdist.search.linearized import LinearizedDesign
from pfdist.search.race import Race
from pfdist.search.random_trials import RandomTrials
from pfdist.search.refine import Refine
from pfdist.search.state_space_relaxation import StateSpaceRelaxation
from pfdist.search.survivors import Survivors
