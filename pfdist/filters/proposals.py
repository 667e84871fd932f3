"""The proposals that a job can name by ``filter.proposal``: the plain one, and those of plugins."""

from typing import TYPE_CHECKING, Final, Literal

from pfdist.common.plugins import added
from pfdist.filters.proposal import PLAIN, Proposal

AUTO: Final = "auto"  # the one that loses least in the same time
FEW_VALUES: Final = 20
"""Fewer different values of a component that does not move are too few for an estimate."""
MOST_INSTANTS: Final = 2000
"""The largest horizon for which a choice takes particles that move: their work grows with it."""
PROPOSALS: dict[str, Proposal] = {each.name: each for each in (PLAIN, *added("proposals"))}
RIVALS = tuple(each for each in PROPOSALS.values() if each.cost > 1)
"""Those that "auto" takes where they lose less than the plain one in the same time."""
THAT_MOVES = next((each for each in PROPOSALS.values() if each.moves), None)
"""The one that moves lines of particles, if there is one."""
FOR_CONSTANTS = f'filter.proposal = "{THAT_MOVES.name}"' if THAT_MOVES else ""
"""How to take it, for messages."""
if TYPE_CHECKING:
    ProposalName = str
else:
    ProposalName = Literal[(AUTO, *PROPOSALS)]
