"""Checks of a particle filter's settings against its model."""

from pfdist.common.section import checked
from pfdist.errors import ModelError, PriorError
from pfdist.filters.cloud import Prior
from pfdist.filters.draws import Draws, check_prior
from pfdist.filters.work import Estimation
from pfdist.kernels.schemes import SCHEMES
from pfdist.models import StateSpaceModel

RESAMPLING = tuple(SCHEMES)
_CHECKED = checked(Estimation)


def check_start(model: StateSpaceModel, draws: Draws, prior: Prior | None) -> None:
    """Raise `PriorError` if a filter with this prior cannot start when the draws start."""
    start = 0 if prior is None else prior.t
    if start != draws.start:
        raise PriorError(
            f"a filter must start at the first instant of its draws, {draws.start}, got a prior "
            f"for {start}"
        )
    if prior is not None:
        check_prior(prior, model, draws.instants[-1])


def check_fits(model: StateSpaceModel, truth: StateSpaceModel) -> None:
    """Raise `ModelError` if y or z of a filter's model has other components than the truth's."""
    for component, true, believed in zip("xyz", truth.components, model.components, strict=True):
        if true != believed and component != "x":
            raise ModelError(
                f"the filter's model must have as many components of {component} as the model "
                f"{truth.name}, {true}, got {believed}"
            )
    if [*model.sensors] != [*truth.sensors]:
        raise ModelError(
            f"the filter's model must have the sensors of the model {truth.name}, "
            f"{', '.join(truth.sensors) or 'none'}, got {', '.join(model.sensors) or 'none'}"
        )


def check_filter_settings(
    model: StateSpaceModel, truth: StateSpaceModel, settings: Estimation
) -> None:
    """Raise an error if a filter's settings are wrong or do not fit its model and the truth.

    Raises ArgumentError for a value that is not allowed, and ModelError for a setting or model that
    does not fit.
    """
    check_fits(model, truth)
    _CHECKED(**vars(settings))
    if model.sensors and settings.carries:
        raise ModelError(
            "resample must be 'always' for a model with sensors, got "
            f"'below {settings.threshold:g}' for {model.name}"
        )
