"""The settings of a job with which `pfdist.why` goes together."""

from pfdist.problem.needs import MEAN_OF_SCENARIOS, ONE_NUMBER, Capability

WHY = Capability("`pfdist why`", {ONE_NUMBER: "", MEAN_OF_SCENARIOS: ""})
