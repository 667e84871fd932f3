"""Sensors chosen one time after another by the greedy sensor manager of Stone Soup.

The manager sees one instrument whose mode is actionable: each mode is a sensor. At each time it
predicts the track, and takes the mode whose update reduces the norm of the covariance most. It
knows neither the times to come nor a budget for them. With one instrument, the manager by brute
force chooses the same.

References
----------
Stone Soup, https://stonesoup.readthedocs.io, "Sensor management".
"""

from collections.abc import Iterator, Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from stonesoup.base import Property
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import LinearGaussianTimeInvariantTransitionModel
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.sensor.sensor import SimpleSensor
from stonesoup.sensormanager import GreedySensorManager
from stonesoup.sensormanager.action import Action, ActionableProperty, ActionGenerator
from stonesoup.sensormanager.reward import UncertaintyRewardFunction
from stonesoup.types.hypothesis import SingleHypothesis
from stonesoup.types.state import GaussianState
from stonesoup.types.track import Track
from stonesoup.updater.kalman import KalmanUpdater

_START = datetime(2020, 1, 1)
_STEP = timedelta(seconds=1)


class _SetMode(Action):  # type: ignore[misc]
    def act(self, current_time: Any, timestamp: Any, init_value: Any, **_: Any) -> Any:
        return self.target_value


class _Modes(ActionGenerator):  # type: ignore[misc]
    @property
    def default_action(self) -> _SetMode:
        return self._to(self.current_value)

    def __contains__(self, item: Any) -> bool:
        return bool(0 <= getattr(item, "target_value", item) < len(self.owner.rows))

    def __iter__(self) -> Iterator[_SetMode]:
        return map(self._to, range(len(self.owner.rows)))

    def _to(self, mode: int) -> _SetMode:
        return _SetMode(generator=self, end_time=self.end_time, target_value=mode)


class _Instrument(SimpleSensor):  # type: ignore[misc]
    rows: Any = Property(doc="The observation row of each mode.")
    sds: Any = Property(doc="The standard deviation of each mode.")
    mode: int = ActionableProperty(generator_cls=_Modes, default=0)

    @property
    def measurement_model(self) -> LinearGaussian:
        row = np.array(self.rows[self.mode])
        used = [int(place) for place in np.flatnonzero(row)]
        model = LinearGaussian(len(row), used, np.diag([self.sds[self.mode] ** 2] * len(used)))
        if len(used) > 1 or row[used[0]] != 1.0:
            raise ValueError(f"a mode must see one component, got {row}")
        return model

    def is_detectable(self, state: Any, measurement_model: Any = None) -> bool:
        return True

    def is_clutter_detectable(self, state: Any) -> bool:
        return True


def chosen(
    transition: Any,
    process_covariance: Any,
    covariance_before: Any,
    rows: Sequence[Sequence[float]],
    sds: Sequence[float],
    times: Sequence[int],
) -> list[int]:
    """The number of the sensor that the manager chooses at each of some times.

    `covariance_before` is that of x one step before time 0.
    """
    predictor = KalmanPredictor(
        LinearGaussianTimeInvariantTransitionModel(
            transition_matrix=np.array(transition), covariance_matrix=process_covariance
        )
    )
    updater = KalmanUpdater(None)
    instrument = _Instrument(rows=rows, sds=sds)
    instrument.timestamp = _START - _STEP
    manage = GreedySensorManager(
        {instrument}, reward_function=UncertaintyRewardFunction(predictor, updater)
    )
    # A manager predicts the track by a step, so the track begins a step before time 0.
    zeros, modes = np.zeros((len(transition), 1)), list[int]()
    track = Track([GaussianState(zeros, covariance_before, timestamp=_START - _STEP)])
    for t in range(max(times) + 1):
        now = _START + t * _STEP
        if t in times:
            (config,) = manage.choose_actions({track}, now)
            for sensor, actions in config.items():
                sensor.add_actions(actions)
                sensor.act(now)
            modes.append(instrument.mode)
        track.append(predictor.predict(track, timestamp=now))
        if t in times:
            seen = instrument.measure({track.state}, noise=False)
            track.append(updater.update(SingleHypothesis(track.state, seen.pop())))
    return modes
