from collections.abc import Callable

import pytest

from pfdist.errors import ModelError
from pfdist.models.linear_gaussian import linear_gaussian

COUPLED = ((1.0, 0.0), (0.5, 1.0))


@pytest.mark.parametrize("noise", [COUPLED, lambda t: COUPLED], ids=["a matrix", "of t"])
def test_coupled_measurement_noise_is_refused(
    noise: tuple[tuple[float, ...], ...] | Callable[[int], tuple[tuple[float, ...], ...]],
) -> None:
    """The likelihood is a product over the measurements, so their noises must be independent."""
    with pytest.raises(ModelError, match=r"model m: .* diagonal, got 0\.5 in row 1, column 0"):
        linear_gaussian(
            "m",
            initial_noise=[[1]],
            transition=[[1]],
            process_noise=[[1]],
            measurement=[[1], [2]],
            measurement_noise=noise,
            quantity_of_interest=[[1]],
        )
