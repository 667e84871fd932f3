"""A rule, and the penalty of measurements, in the form that the compiled filter reads."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.filters.draws import Draws
from pfdist.filters.formulas import simulation_blocks
from pfdist.filters.proposal import PLAIN
from pfdist.filters.work import Estimation
from pfdist.kernels.deciding import ruling_of
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.replicates import replicates_of
from pfdist.kernels.rules import Ruling
from pfdist.models import StateSpaceModel


def applied(
    model: StateSpaceModel, draws: Draws, planned: Plan, settings: Estimation
) -> tuple[Plan, Ruling, dict[str, NDArray[Any]]]:
    """The plan that the rule of some settings fills, the rule, and the results that it fills.

    Without a rule, the plan stays as it is.
    """
    is_alone = settings.proposal != PLAIN.name or bool(np.any(settings.lag))
    planned, ruling, filled = ruling_of(
        settings.rule, planned, draws.index, draws.instants, len(model.ways), is_alone=is_alone
    )
    if settings.penalty:
        replicates = replicates_of(
            settings.penalty, simulation_blocks(model, draws.instants).blocks,
            model.noise_of_measurements, [way.v.start for way in model.ways],
            len(draws.index), *model.components[:2],
        )  # fmt: skip
        ruling = ruling._replace(replicates=replicates)
    return planned, ruling, filled
