"""The needs of a choice of times on the way."""

from pfdist.problem.needs import EXPECTED_MSE, FILTERED, LEARNED, SAME_STATES, Capability

ON_THE_WAY = Capability(
    "`[online]`, `pfdist online`, `next`, `Planner`",
    {
        FILTERED: "particles of now have no past: make measured times problem.required, allow only "
        "them and later ones, and plan again (docs/afterwards.md)",
        LEARNED: "the filter learns nothing about the scenario of a draw",
        EXPECTED_MSE: "", SAME_STATES: "systems are simulated from the filter's particles",
    },
    lambda job: "online" * (job.section("online") is not None),
)  # fmt: skip
