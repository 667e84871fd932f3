"""Linear-Gaussian systems of many kinds, whose expected errors are known without draws."""

from typing import Any

from oracles.kalman import SCALAR, THREE, TRACKING
from pfdist import StateSpaceModel, linear_gaussian, load_model


def scalar(name: str, factor: float, push: float, noise: float) -> StateSpaceModel:
    """x' = factor x + push w, with a prior of sd 2 and measurements with this noise."""
    return linear_gaussian(
        name,
        initial_noise=[[2.0]],
        transition=[[factor]],
        process_noise=[[push]],
        measurement=[[1.0]],
        measurement_noise=[[noise]],
        quantity_of_interest=[[1.0]],
    )


def one_state(name: str, **changes: Any) -> StateSpaceModel:
    """x' = x + w, measured with v, all noise standard normal, but for these formulas and fields."""
    noises = ("initial_noise", "process_noise", "measurement_noise")
    given: dict[str, Any] = dict.fromkeys(noises, ("normal",)) | {
        "initial": lambda w, p: (w[0],),
        "transition": lambda x, t, w, p: (x[0] + w[0],),
        "measurement": lambda x, t, v, p: (x[0] + v[0],),
        "log_likelihood": lambda y, x, t, p: -0.5 * (y[0] - x[0]) ** 2,
        "quantity_of_interest": lambda x, t, p: (x[0],),
    }
    return StateSpaceModel(name=name, **given | changes)


SYSTEMS = {
    "stable": scalar("stable", 0.7, 1.0, 0.5),
    "random walk": scalar("walk", 1.0, 1.0, 1.0),
    "static": scalar("static", 1.0, 0.0, 1.0),
    "unstable": scalar("unstable", 1.05, 0.5, 0.3),
    "forgetful": SCALAR.as_model(),
    "tracking": TRACKING.as_model(),
    "three states": THREE.as_model(),
    "constant velocity": linear_gaussian(
        "constant velocity",
        initial_noise=[[1.0, 0.0], [0.0, 1.0]],
        transition=[[1.0, 1.0], [0.0, 1.0]],
        process_noise=[[0.1], [0.2]],
        measurement=[[1.0, 0.0]],
        measurement_noise=[[0.5]],
        quantity_of_interest=[[1.0, 0.0]],
    ),
    "sharp now and then": linear_gaussian(
        "sharp",
        initial_noise=[[3.0]],
        transition=[[1.0]],
        process_noise=[[0.5]],
        measurement=[[1.0]],
        measurement_noise=lambda t: ((0.05 if t % 3 == 0 else 1.5,),),
        quantity_of_interest=[[1.0]],
    ),
    "wanted late": linear_gaussian(
        "late",
        initial_noise=[[1.0]],
        transition=[[1.0]],
        process_noise=[[0.4]],
        measurement=[[1.0]],
        measurement_noise=[[0.4]],
        quantity_of_interest=lambda t: ((0.1 + t / 4,),),
    ),
    "oscillator": load_model("linear_gaussian"),
    "walk that ships": load_model("random_walk"),
}
