"""The arrays and steps of a moving filter."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pfdist.filters.cloud import CarriedLines, Cloud
from pfdist.filters.draws import Draws
from pfdist.filters.work import Estimation
from pfdist.kernels import filter as plain
from pfdist.kernels.batch import CloudBatch, FilterArrays, FilterRequest, Lines, Steps
from pfdist.kernels.blocks import Source
from pfdist.kernels.memory import in_memory, zeros
from pfdist.kernels.prefixes import Plan
from pfdist.models import StateSpaceModel
from pfdist.plugins.moving import kernel
from pfdist.plugins.moving.gains import Gains, additive_gains
from pfdist.plugins.moving.moves import OF_CONSTANTS, OF_PATHS, Move, Moving

_MOST_SAVED = 2**24  # numbers of single precision of saved lines, about


@dataclass(frozen=True)
class Moved:
    """The extension of a filter that moves its particles; see `pfdist.kernels.filter`."""

    moves: Sequence[Move]
    initial: int  # components of the initial noise
    process: int  # of the process noise
    gains: Gains | None
    carried: CarriedLines | None = None  # that the filter continues
    begins: bool = True  # whether lines begin with the initial noise
    redrawn: tuple[bool, ...] = ()

    @property
    def blocks(self) -> Mapping[int, Source]:
        """None but those of the model."""
        return {}

    def together(self, request: FilterRequest, plan: Plan, width: int) -> int:
        """One draw at a time: each needs another number of steps."""
        return 1

    def planned(self, request: FilterRequest, plan: Plan) -> Plan:
        """The plan; without saved lines if these would take too much memory.

        Lines that are continued are those of a slot of their own, -1.
        """
        rows = request.instants * (request.components + request.sensors)
        too_many = plan.clouds * rows * request.particles > _MOST_SAVED
        plan = plan.unshared if too_many else plan
        if self._until <= 0:
            return plan
        is_first = plan.begins == 0
        begins = np.where(is_first, self._until, plan.begins)
        return plan._replace(begins=begins, sources=np.where(is_first, -1, plan.sources))

    @property
    def _until(self) -> int:
        """The number of steps of continued lines before their last; -1 for none."""
        return -1 if self.carried is None else len(self.carried.noise) - 1

    def arranged(
        self,
        request: FilterRequest,
        plan: Plan,
        results: FilterArrays,
        batch: CloudBatch,
        kept: Lines,
        steps: Steps,
    ) -> tuple[Steps, int, Any]:
        """Steps that keep and move lines, and the lines."""
        instants, stride, gains = request.instants, batch.stride, self.gains
        carried, nothing = self.carried, np.zeros((0, 0, 0))
        noise = instants * request.components * batch.spacious
        states = instants * request.states * stride
        events = instants * request.sensors
        slots, count = plan.clouds if steps.save else 0, max(1, self.initial)
        memory, arrays = zeros(
            Moving,
            now=4,
            event=2 * events + 2,
            noise=noise,
            tried=noise,
            path=states,
            tried_path=states,
            known=events * stride,
            tried_known=events * stride,
            likelihood=stride,
            tried_likelihood=stride,
            ratio=stride,
            row=stride,
            single=batch.spacious,
            normals=count * batch.spacious,
            solved=count * stride,
            mean=count,
            root=count * count,
            saved_noise=slots * noise,
            saved_states=slots * request.states * stride,
            saved_known=slots * events * stride,
            saved_event=slots * events * 2,
            saved_now=slots * 4,
            saved_means=slots * instants * kept.rows * batch.row if request.lag else 0,
        )
        own = Moving(
            begin=steps.begin,
            move=steps.move,
            save=steps.save,
            resume=steps.resume,
            finish=kept.finish,
            moves=len(self.moves),
            kind=np.array([move.kind for move in self.moves]),
            scale=np.array([move.scale for move in self.moves]),
            span=np.array([move.span for move in self.moves]),
            components=self.initial if self.begins else 0,
            process=self.process,
            driven=np.zeros(1, np.int64) if gains is None else gains.driven,
            inverse=np.zeros(1) if gains is None else gains.inverse.ravel(),
            keeps_path=gains is not None,
            until=self._until,
            columns=carried.states.shape[1] if carried else 0,
            carried_noise=carried.noise if carried else nothing.astype(np.float32),
            carried_states=carried.states if carried else nothing,
            carried_counts=carried.counts if carried else nothing.astype(np.uint8),
            keeps=results.noise.size > 0,
            keep=steps.keep,
            events=events,
            **arrays,
        )
        changed: dict[str, Any] = {
            "begin": kernel.begin, "move": kernel.move, "weigh": kernel.measure,
        }  # fmt: skip
        if steps.save or self._until > 0:
            changed["resume"] = kernel.resume
        if steps.save:
            changed["save"] = kernel.save
        if steps.keep:
            changed["keep"] = kernel.keep_lines
        if request.lag:
            changed |= {"estimate": kernel.estimate_lines, "finish": kernel.finish_lines}
        addresses = {name: step.address for name, step in changed.items()}
        addresses |= {"resample": plain.resample_cloud.address, "tell": 0}
        return steps._replace(**addresses), *_placed(own, memory)


def moved_extension(model: StateSpaceModel, draws: Draws, settings: Estimation) -> Moved:
    """The extension of the filter of a model."""
    instants, prior = draws.instants, settings.prior
    found: Moved = model.kept(("moved", instants), lambda: _moved(model, instants))
    if not isinstance(prior, Cloud):
        return found
    lines = prior.lines_for(model)
    if lines is None:
        return replace(found, begins=False)
    return replace(found, carried=lines, begins=lines.begins)


def _moved(model: StateSpaceModel, instants: range) -> Moved:
    initial, process = len(model.initial_noise), len(model.process_noise)
    moves = OF_PATHS if process else OF_CONSTANTS
    return Moved(moves, initial, process, additive_gains(model, instants))


def _placed(own: Moving, memory: Any) -> tuple[int, Any]:
    numbers = in_memory(own)
    return numbers.ctypes.data, (numbers, own, memory)
