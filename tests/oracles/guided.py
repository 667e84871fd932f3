"""A model of sharp sensors, whose guided filter is compared with the exact filter."""

import numpy as np

from pfdist import StateSpaceModel, linear_gaussian

SHARP = 0.001


def sharp_walk(dimensions: int, sensor: float = SHARP) -> StateSpaceModel:
    """A random walk in some dimensions, each seen by a sensor of 0.001 of the prior's deviation."""

    def times(factor):
        return (factor * np.eye(dimensions)).tolist()

    return linear_gaussian(
        f"walk in {dimensions}",
        initial_noise=times(1.0),
        transition=times(1.0),
        process_noise=times(0.5),
        measurement=times(1.0),
        measurement_noise=times(sensor),
        quantity_of_interest=times(1.0),
    )
