"""The settings of a job with which plans for each replicate go together."""

from pfdist.problem.needs import A_NUMBER, LEARNED, Capability

PLAN_EACH = Capability(
    "`plan_each` of `pfdist backtest`",
    {A_NUMBER: "without plan_each, the plan of the run is judged", LEARNED: ""},
)
