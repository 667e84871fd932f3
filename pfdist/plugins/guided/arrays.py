"""The arrays, blocks and steps of a guided filter."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pfdist.errors import ModelError
from pfdist.filters.draws import Draws
from pfdist.filters.formulas import layout_of
from pfdist.filters.work import Estimation
from pfdist.kernels.batch import CloudBatch, FilterArrays, FilterRequest, Lines, Steps
from pfdist.kernels.blocks import Source
from pfdist.kernels.memory import in_memory, zeros
from pfdist.kernels.prefixes import Plan
from pfdist.kernels.schemes import ALL_SCHEMES
from pfdist.kernels.variates import TRUTH_INITIAL, TRUTH_PROCESS, variates
from pfdist.models import StateSpaceModel
from pfdist.models.program import groups_of
from pfdist.models.symbols import RefusedError
from pfdist.models.tracing import MODES, Formula, Traced, trace
from pfdist.plugins.guided import kernel
from pfdist.plugins.guided.formulas import Guide, guide_of

_MOST_DERIVED = 5_000  # operations of a program: a larger one takes minutes to compile
_MOST_NOISE = 2**21  # numbers of the noise of all paths, about
# Linearisations: with sharp ranges and bearings, errors were 3 times too large after one, 1 % after
# two, and as after six after three.
_ROUNDS = 3


@dataclass(frozen=True)
class Guided:
    """The extension of a guided filter; see `pfdist.kernels.filter.Extension`."""

    rows: tuple[int, ...]  # of each sensor's guide; 0 for a sensor that has none
    sources: tuple[dict[int, Source], ...]  # the blocks of each, see `pfdist.plugins.guided.kernel`
    rounds: int  # of linearisations
    # (D, T+1, components): noise of the truth's step to each instant, if it is a particle
    truth_noise: NDArray[np.float64] | None = None

    @property
    def redrawn(self) -> tuple[bool, ...]:
        """Whether a measurement of each sensor redraws the noise since the last one."""
        return tuple(count > 0 for count in self.rows)

    @property
    def blocks(self) -> dict[int, Source]:
        """Blocks beyond those of all sensors, by their place."""
        return {
            int(kernel.BLOCKS) * number + row: source
            for number, of_sensor in enumerate(self.sources)
            for row, source in of_sensor.items()
        }

    def together(self, request: FilterRequest, plan: Plan, width: int) -> int:
        """The most draws of a batch."""
        return max(1, _MOST_NOISE // ((kernel.longest_gap(plan) + 1) * request.components * width))

    def planned(self, request: FilterRequest, plan: Plan) -> Plan:
        """The plan as it is."""
        return plan

    def arranged(
        self,
        request: FilterRequest,
        plan: Plan,
        results: FilterArrays,
        batch: CloudBatch,
        kept: Lines,
        steps: Steps,
    ) -> tuple[Steps, int, Any]:
        """Steps that redraw the noise of paths, and the arrays of these paths."""
        gap, most, chunk = kernel.longest_gap(plan) + 1, max(self.rows), int(kernel.CHUNK)
        record = kernel.record_rows(request.states, request.components, most)
        states = request.states * batch.stride
        memory, arrays = zeros(
            kernel.Guiding,
            origin=states,
            saved_origin=plan.clouds * states if steps.save else 0,
            records=(gap + 1) * record * chunk,
            noises=2 * gap * request.components * batch.spacious,
            noise=(most + 1) * batch.spacious,
            drawn=(most + 1) * chunk,
            ratio=batch.stride,
        )
        own = kernel.Guiding(
            save=steps.save,
            resume=steps.resume,
            rows=np.array(self.rows, np.int64),
            rounds=self.rounds,
            record_rows=record,
            truth_noise=np.empty((0, 0, 0)) if self.truth_noise is None else self.truth_noise,
            **arrays,
        )
        changed = {
            "set_out": kernel.set_out, "redraw": kernel.redraw, "add_ratio": kernel.add_ratio,
            "leave_out": kernel.leave_out,
        }  # fmt: skip
        if steps.save:
            changed |= {"save": kernel.save_paths, "resume": kernel.resume_paths}
        addresses = {name: step.address for name, step in changed.items()}
        numbers = in_memory(own)
        return steps._replace(**addresses), numbers.ctypes.data, (numbers, own, memory)


def guided_extension(model: StateSpaceModel, draws: Draws, settings: Estimation) -> Guided:
    """The extension of the filter of a model; raises `ModelError` if no sensor has a guide."""
    instants = draws.instants
    found: Guided = model.kept(("guided", instants), lambda: _guided(model, instants))
    if not ALL_SCHEMES[settings.resampling].holds_truth:
        return found
    return replace(found, truth_noise=_truth_noise(draws))


def _guided(model: StateSpaceModel, instants: range) -> Guided:
    rows_of, sources, refused = list[int](), list[dict[int, Source]](), list[Exception]()
    rounds = 1
    for way in model.ways:
        try:
            guide = guide_of(way.model, instants)
            sources.append({} if guide is None else _sources(guide, instants))
            rows_of.append(0 if guide is None else guide.rows)
            if guide is not None and not _is_linear(guide, sources[-1]):
                rounds = _ROUNDS
        except (ModelError, RefusedError) as error:
            sources.append({})
            rows_of.append(0)
            refused.append(error)
    if len(refused) == len(rows_of):
        raise ModelError(f"filter.proposal = 'guided' is not possible: {refused[0]}")
    return Guided(tuple(rows_of), tuple(sources), rounds)


def _is_linear(guide: Guide, sources: dict[int, Source]) -> bool:
    """Whether all derivatives are the same for all particles."""
    slopes, behind = range(guide.rows * guide.model.components[0]), guide.sums
    for row in kernel.SWEPT, kernel.SWEPT_INITIAL, kernel.SEEN:
        source = sources.get(int(row))
        for program in source.traced.programs if source else ():
            last = range(len(slopes) + behind, len(program.outputs))
            derivatives = [*slopes] if row == kernel.SEEN else [*slopes, *last]
            if groups_of(program, derivatives) & {"x", "w", "v"}:
                return False
    return True


def _sources(guide: Guide, instants: range) -> dict[int, Source]:
    """The blocks of a guide; see `pfdist.plugins.guided.kernel`."""
    model, (n, m, _), k = guide.model, guide.model.components, guide.rows
    x, z = {"x": n}, {"x": n, "z": k * n, "estimate": guide.sums}
    w, w0 = (
        {"w": len(each), "v": len(each)} for each in (model.process_noise, model.initial_noise)
    )
    normals, normals0 = (
        each.count("normal") for each in (model.process_noise, model.initial_noise)
    )
    behind, once, steps, t = k * n + guide.sums, instants[:1], instants[:-1], {"t": 0}

    def source(name: str, results: int, given: dict[str, int], at: range) -> Source | None:
        if not at:
            return None
        arguments = {**given, "p": 0}
        formula = Formula(
            getattr(guide, name), name, arguments, model.parameters, model.name, results
        )
        traced: Traced = model.kept(
            ("guide", guide.angles, guide.components, name), lambda: trace(formula, at)
        )
        if traced.mode != MODES[0] and traced.instants != at:
            traced = trace(formula, at)
        if max(len(each.operations) for each in traced.programs) > _MOST_DERIVED:
            raise ModelError(
                f"derivatives of {model.name} have more than {_MOST_DERIVED:,} operations"
            )
        return Source(traced.at(at), layout_of(formula), model.parameters, results)

    sources = {
        kernel.MEAN: source("mean", n, {**x, **t, **w}, steps),
        kernel.MEAN_INITIAL: source("mean_initial", n, w0, once),
        kernel.SWEPT: source("swept", behind + k * normals, {**z, **t, **w}, steps),
        kernel.SWEPT_INITIAL: source("swept_initial", behind + k * normals0, {**z, **w0}, once),
        kernel.SEEN: source("seen", behind + k, {**x, "y": m, **t}, instants),
        kernel.AIMED: source("aimed", k, {"x": k + guide.sums}, once),
        kernel.DRAWN: source("drawn", k + 1, {"x": k + guide.sums, "u": k + 1}, once),
    }
    return {int(row): each for row, each in sources.items() if each is not None}


def _truth_noise(draws: Draws) -> NDArray[np.float64]:
    """The noise of the truth's step to each instant, (D, T+1, components)."""
    model, index = draws.model, np.array(draws.index)
    count = max(len(model.initial_noise), len(model.process_noise))
    noise = np.zeros((len(index), len(draws.instants), count))
    for k, t in enumerate(draws.instants):
        kinds, role = (
            (model.process_noise, TRUTH_PROCESS) if k else (model.initial_noise, TRUTH_INITIAL)
        )
        for c, kind in enumerate(kinds):
            values = variates(kind, 1, draws.stream, index, t - 1 if k else 0, role, c)
            noise[:, k, c] = values[:, 0]
    return noise
