"""The settings of a job with which the explorer goes together."""

from pfdist.problem.needs import EXPECTED_MSE, Capability

EXPLORE = Capability("`pfdist explore`", {EXPECTED_MSE: ""})
