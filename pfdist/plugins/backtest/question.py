"""Judge a plan by real measurements: whether the gain that the model foresees is found in them."""

import warnings
from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, Unpack

import numpy as np
import pandas as pd
import pyarrow as pa
from numpy.typing import NDArray
from pydantic import Field

from pfdist.common.arguments import sets_argument
from pfdist.common.measurement_times import EVEN
from pfdist.common.section import Number, Whole, checked
from pfdist.errors import (
    ArgumentError,
    JobError,
    MeasurementsError,
    PfdistWarning,
)
from pfdist.models import StateSpaceModel
from pfdist.models.base import within_half_turn
from pfdist.models.sensed import known_values, when_made
from pfdist.plugins.backtest.backtesting import ReplicateErrors
from pfdist.plugins.backtest.page import Backtest, ShownReplicate
from pfdist.plugins.backtest.promise import RelativeErrors, promise, real_over_foreseen
from pfdist.plugins.backtest.thinned import (
    CENTRED,
    FROM_START,
    PLAN,
    Matched,
    judged_errors,
    matched_of,
    plans_of,
)
from pfdist.problem.needs import REAL_DATA
from pfdist.problem.points import Points
from pfdist.problem.problem import JobSource, as_job
from pfdist.problem.replicates import USED, Replicate, read_replicates
from pfdist.questions.at_work import at_work
from pfdist.questions.evaluate import OneSet, instants_evaluated
from pfdist.questions.options import Chosen, Names, Options, following, with_options
from pfdist.questions.planned_run import (
    Columns,
    UserTable,
    check_files,
    files_beside,
    planned_run,
    reading_of,
    table_argument,
)
from pfdist.questions.report import write_page
from pfdist.questions.surprises import IMPROBABLE
from pfdist.results import Run
from pfdist.results.stored_run import measured_of
from pfdist.runner.build import Built, build
from pfdist.runner.progress import silent
from pfdist.store import backtest_schema
from pfdist.store.user_tables import write_user_table

Array = NDArray[np.float64]
BEST = "the best evenly spaced times"
SHOWN = 4
"""Replicates that a report shows in full."""


@with_options
@checked
def backtest(
    job: JobSource | Run,
    data: UserTable,
    *,
    replicate: str = "",
    times: Mapping[str, OneSet] | Names | None = None,
    planned: str = "",
    plan_each: bool = False,
    columns: Columns | None = None,
    within: Annotated[Number, Field(ge=0.0, allow_inf_nan=False)] | None = None,
    block: Annotated[Whole, Field(ge=1, le=10_000)] = 1,
    out: str | Path = "",
    results: str | Path | None = None,
    changes: Iterable[str] = (),
    **options: Unpack[Options],
) -> Backtest:
    """Judge by real measurements whether a plan keeps its promise.

    The table has more measurements of each system, a replicate, than the plan needs. Each replicate
    is filtered with its measurements at the times of the plan, at two grids of evenly spaced times,
    at the best evenly spaced times of the run, and at sets of your own. The predictions are judged
    by the measurements that no set uses. The model foresees these errors by simulated systems that
    are measured and judged at the same times.

    A table, ``NAME.backtest.csv`` or ``.parquet`` as the data are, a figure, ``NAME.backtest.png``,
    and a report, ``NAME.backtest.html``, are written. They replace those of an earlier call, and no
    other file.

    Parameters
    ----------
    job : Problem, Job, str, Path or Run
        A job file, whose run is meant, or the folder of a run.
    data : str, Path or DataFrame
        Table in CSV or Parquet with a row for each replicate and time: a column with the
        replicate's name, t, y0, y1, ... (or ``y_NAME``), and sensor if the model has sensors.
        Further columns may be z0, z1, ... (known quantities of interest, judged instead), train (1
        for a replicate to which the model was fitted; it is not judged), and parameters.
    replicate : str, optional
        Column with the name of the replicate; by default the first.
    times : mapping of str to iterable or str, optional
        Further sets to compare, as ``clinic=0,6,12,24``; give the option once for each set.
    planned : str, optional
        Name of the compared set that was planned; by default the found set with the lowest expected
        MSE.
    plan_each : bool
        Plan for each replicate among its own measurements; then no run is needed.
    columns : mapping of str to str, or list of str, optional
        Names of the table's columns that have other names there, as ``t=time,y0=conc``.
    within : float, optional
        Largest distance from a wanted time to the nearest measured time, which is used instead, and
        from a measured time to the nearest instant if the model's step does not read p.dt; by
        default half a step of the clock.
    block : int
        Number of consecutive replicates that may depend on each other, such as 7 days.
    out : str or Path, optional
        Folder of the table, the figure and the report; by default that of the given table.
    results : str or Path, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if only that holds a run.
    changes : iterable of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    options
        See `Options`.

    Returns
    -------
    Backtest

    Raises
    ------
    StoreError
        There is no finished run of the job, or a file cannot be written.
    MeasurementsError
        The table is wrong, or no replicate can be judged.
    JobError, ModelError
        The job or a parameter does not fit.
    """
    # Not above: the help of the command waits for no Matplotlib.
    from pfdist.pages.figure import save_plot  # noqa: PLC0415
    from pfdist.plugins.backtest import figures  # noqa: PLC0415

    chosen, table = Chosen(**options), table_argument("data", data)
    files = files_beside(table, out, "data", "backtest")[: 3 if chosen.report is not False else 2]
    check_files(files, backtest_schema(), figures.TITLE)
    with following(chosen.progress, chosen.say) as (show, tell):
        if plan_each:
            source: Any = job.path if isinstance(job, Run) else job
            built, plan, even = build(as_job(source, changes)), None, {}
        else:
            found = planned_run(job, results, changes, tell, planned, "", must_be=True)
            built, plan = found.built, found.times
            measured = measured_of(found.run) if found.run else {}
            even = {EVEN: measured[EVEN]} if EVEN in measured else {}
        _check_filter(built)
        execution = built.job.with_changes(settings={"execution": chosen.execution}).execution
        model, clock = built.evaluator.model, built.job.problem.clock
        names = [*clock.without({**model.parameters, **built.evaluator.believed.parameters})]
        reading = reading_of(built, columns, within, chosen.say)
        replicates = read_replicates(table, replicate, model, clock, names, reading)
        _check_columns(built, replicates)
        if within is None:
            within = (clock.times[-1] - clock.times[0]) / clock.horizon / 2
        own = {
            name: instants_evaluated(built.job, name, each)
            for name, each in sets_argument(times or {}).items()
        }
        for name in {*own} & {PLAN, FROM_START, CENTRED, EVEN}:
            raise ArgumentError(f"times: {name!r} is the name of another set; choose another name")
        own = even | own
        with at_work(execution, [built.evaluator.engine], tell) as pool:
            plans = plans_of(built, replicates, pool, show) if plan is None else plan
            matched, left_out = matched_of(built, replicates, plans, own, within)
            if not matched:
                why = next((f"{name}: {each}" for name, each in left_out.items()), "no rows")
                more = "; --within allows more" * (" within " in why and USED not in why)
                raise MeasurementsError(f"no replicate can be judged ({why}){more}")
            errors = judged_errors(built, matched, pool, show)
    first = f"evenly spaced times from t = {clock.formatted(0)}"
    sets = {PLAN: "the plan", FROM_START: first, CENTRED: "centred evenly spaced times"}
    sets |= {name: f"the set {name}" for name in own} | dict.fromkeys(even, BEST)
    result = _result(
        sets,
        model,
        built.job.problem.points,
        matched,
        errors,
        block,
        data=Path("data") if isinstance(table, pd.DataFrame) else table,
        plan=() if plan is None else tuple(built.job.problem.points.written_of(plan)),
        left_out=left_out,
        is_checked=any(each.is_training for each in replicates),
        within=within,
        files=files,
        quantities=model.named("y") if matched[0].is_predicted else model.named("z"),
        clock=clock,
    )
    if files:
        from pfdist.plugins.backtest.page import report_of  # noqa: PLC0415  as in Backtest

        rows = pa.Table.from_pandas(result.table, schema=backtest_schema(), preserve_index=False)
        write_user_table(files[0], rows)
        plot = figures.by_replicate(result.table, result.sets)
        save_plot(files[1], plot, figures.TITLE)
        for file in files[2:]:
            write_page(report_of(result), file)
    page = result._page()
    for line in (*page.alarms, *page.warnings) if chosen.say is silent else ():
        warnings.warn(line, PfdistWarning, stacklevel=3)
    return result


def _check_filter(built: Built) -> None:
    """Raise `JobError` if the job's filter cannot filter real systems here."""
    scenarios, delays = built.job.scenarios, built.job.problem.points.delays
    REAL_DATA.check("a real system", built.job)
    if delays and scenarios is not None and scenarios.is_learned:
        raise JobError(
            "scenarios.filter must be 'nominal' with sensors that have a delay, got 'learned': or "
            "leave out the delay, and give the times at which values arrive"
        )


def _check_columns(built: Built, replicates: Iterable[Replicate]) -> None:
    """Raise `MeasurementsError` if a column has a parameter of which the job has scenarios."""
    given = () if built.job.scenarios is None else built.job.scenarios.parameters
    varied = {*given} if isinstance(given, Mapping) else {*chain(*given)}
    for each in replicates:
        for name in varied & {*each.parameters}:
            raise MeasurementsError(
                f"column {name}: a parameter with scenarios or a distribution in the job must have "
                "no column"
            )


def _result(
    sets: Mapping[str, str],
    model: StateSpaceModel,
    points: Points,
    matched: Sequence[Matched],
    errors: Sequence[ReplicateErrors],
    block: int,
    **known: Any,
) -> Backtest:
    """The result, given the fields that are known before it."""
    of_sets = {
        name: RelativeErrors(
            np.array([each.real[k] for each in errors]),
            np.stack([
                np.where(np.isfinite(each.foreseen[k]), each.foreseen[k], np.nan)
                for each in errors
            ]),
        )
        for k, name in enumerate(sets)
    }  # fmt: skip
    rows = [
        {
            "replicate": each.replicate.name,
            "set": name,
            "judged": int(np.sum(~np.isnan(each.judged))),
            "real": one_set.real[place],
            "foreseen": one_set.means[place],
            "covered": errors[place].covered[k],
        }
        for place, each in enumerate(matched)
        for k, (name, one_set) in enumerate(of_sets.items())
    ]
    plan, others = of_sets[PLAN], [*of_sets.items()][1:]
    order = np.argsort(of_sets[FROM_START].real - plan.real)
    places = [int(order[round(share * (len(order) - 1))]) for share in np.linspace(0.1, 0.9, SHOWN)]
    shown = list[ShownReplicate]()
    for place in dict.fromkeys(places):
        (replicate, used, known_z), found = matched[place], errors[place]
        if matched[place].is_predicted:
            y = known_values(replicate.y[:, : model.components[1]])
            known_z = when_made(y, model, points.delays)
        near = within_half_turn(known_z, found.estimates[0], found.is_angle)
        times = np.array(replicate.clock.times, np.float64)
        shown.append(ShownReplicate(replicate.name, times, near, points.made(used[0]), found))
    surprises = np.concatenate([each.surprises for each in errors])
    return Backtest(
        sets=sets,
        promises={name: promise(plan, each, block) for name, each in others},
        ratios={name: real_over_foreseen(each, len(sets), block) for name, each in of_sets.items()},
        table=pd.DataFrame(rows),
        noise=float(np.mean([each.noise for each in errors])),
        improbable=float(np.mean(surprises < IMPROBABLE)),
        impossible=sum(each.impossible for each in errors),
        collapsed=sum(each.collapsed for each in errors),
        shown=tuple(shown),
        **known,
    )
