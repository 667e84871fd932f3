"""The needs of several numbers of measurements."""

from pfdist.problem.needs import EXPECTED_MSE, MEAN_OF_SCENARIOS, Capability, Fact

PLANNED_AHEAD = Fact(
    "no `[online]`", "a job without a section online", lambda job, _: job.section("online") is None
)
BUDGET = Capability(
    "`[budget]`",
    {EXPECTED_MSE: "", MEAN_OF_SCENARIOS: "", PLANNED_AHEAD: ""},
    lambda job: "budget" * (job.section("budget") is not None),
)
