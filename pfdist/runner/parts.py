"""The parts of the work of a run, as they are counted and told."""

from pfdist.common.plugins import hooked

Part = str
"""A key of `PARTS`."""
PARTS: dict[Part, str] = {
    "search": "search",
    "opponent": "finding the best evenly spaced times",
    "comparison": "comparison on fresh draws",
    "other estimate": "the error at the moment, or afterwards",
    "statistics": "pictures, and the loss by few particles",
    "scan": "how many evenly spaced ones do as well",
    "proof": "proof",
    "likelihood": "check of the model's likelihood",
    **hooked("parts"),
}
"""Each part in words."""
