"""The settings of a job with which a rule goes together."""

from pfdist.problem.needs import (
    A_SEARCH,
    COMPILED,
    OF_EACH_DRAW,
    PARTICLES,
    SQUARED_NORM,
    Capability,
)

RULES = Capability(
    "`pfdist rule`",
    {
        OF_EACH_DRAW: "", A_SEARCH: "there is no plan",
        PARTICLES: "its spread does not depend on y, so a rule is a fixed set",
        COMPILED: "it takes too long", SQUARED_NORM: "",
    },
)  # fmt: skip
