"""The objects that the names in a job declare: model, evaluator, optimisers, pool."""

import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from pfdist.common.component_names import Component
from pfdist.common.measurement_times import LINEARIZED, Times
from pfdist.common.nearest import must_be
from pfdist.errors import EngineWarning, JobError, ModelError, StoreError, shown
from pfdist.filters.constants import constants_of
from pfdist.filters.engines import AUTO as AUTO_ENGINE
from pfdist.filters.engines import BATCHED, COMPILED, WITHOUT_FMA
from pfdist.filters.evaluator import Evaluator, recorded_evaluator
from pfdist.filters.proposal import PLAIN
from pfdist.filters.proposals import AUTO, PROPOSALS
from pfdist.filters.variants import knowing_truth, self_consistent
from pfdist.kernels.lowering import has_fused_multiply_add
from pfdist.models import PYTHON, StateSpaceModel, installed_models, load_model
from pfdist.models.continuous import with_events
from pfdist.models.learned import learned
from pfdist.models.mistakes import NO_CLOCK, NO_DATES
from pfdist.models.parameters import check_lengths
from pfdist.models.recorded import declarations, differences, with_functions
from pfdist.models.sensed import sensed
from pfdist.pools.base import Pool
from pfdist.pools.kinds import AUTO as AUTO_POOL
from pfdist.pools.kinds import POOLS, cluster_at_hand
from pfdist.problem.clock import Clock
from pfdist.problem.job import Job
from pfdist.problem.needs import LOSS
from pfdist.problem.scenarios_section import Scenarios
from pfdist.problem.sections import Execution, FilterModel, Model
from pfdist.runner.built import Built as Built  # noqa: PLC0414  `build` returns it
from pfdist.runner.choice import (
    check_beside_truth,
    choice,
    choice_of_run,
    choices_of,
    moved_particles,
    steps_a_particle,
)
from pfdist.runner.contract import few_draws
from pfdist.runner.design import design_of
from pfdist.runner.later import later_of
from pfdist.runner.progress import Detail
from pfdist.runner.searches import (
    Settings,
    comparing_of,
    named_search,
)
from pfdist.runner.study import study_of

Models = tuple[StateSpaceModel, StateSpaceModel]
"""The true model, and that of the filter."""


def build(job: Job, *runs: Path, asked: float | None = None, follows: bool = False) -> Built:
    """The objects of a job, after a check that they fit each other.

    The proposal "auto" is replaced by a choice that takes at most 5 % of the work: `asked` is the
    number of draws that are filtered, counted for each set, by default those of the job's run. If
    the filter `follows` one system, particles move where components of x do not.

    The constants of recorded models come from the first of the given runs' folders that has the
    same models. A job in a run's folder takes its models from there, and imports nothing.

    Raises `ModelError` if the model cannot be loaded, if a parameter is unknown or out of its
    range, or if a resampling scheme does not fit. Raises `JobError` if particles is
    "auto" and no number is sufficient.
    """
    job = with_design(job)
    own, path = job.filter, runs[0] if runs else None
    is_open, is_automatic = own.proposal == AUTO, own.is_automatic
    kept = choice_of_run(path) if is_open and path is not None else ""
    proposal = (kept or PLAIN.name) if is_open else own.proposal
    particles = _USUAL_PARTICLES if is_automatic else own.particles
    # The job is built with the plain filter first, so whatever else is wrong is named first. Its
    # models are recorded here, and nowhere else.
    first = _with_filter(job, proposal, particles)
    evaluator = evaluator_of(first, *models_of_job(first))
    evaluator = next(filter(None, (_as_kept(evaluator, run) for run in runs)), evaluator)
    _check_draws(first, evaluator)
    built = _built(first, evaluator)
    if kept:
        choices_of(built)[""] = kept
    elif is_open:
        proposal = choice(built, asked, follows=follows)
    moves = PROPOSALS[proposal].moves
    if is_automatic and not moves:
        particles = _enough_particles(built, proposal)
    why = PROPOSALS[proposal].why * is_open
    taken = f"filter.proposal: {proposal}, {why}" * bool(why)
    if (proposal, particles) == (first.filter.proposal, first.filter.particles) and not moves:
        return replace(built, taken=taken)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", EngineWarning)  # it came with the first filter
        found = _built(_with_filter(job, proposal, particles, built), built.evaluator)
    return replace(found, taken=taken)


def with_design(job: Job) -> Job:
    """The job whose sets have the times of the linearized design in the place of "linearized".

    Raises `ModelError` as `design_of_job`.
    """
    named, reference = job.comparison.named, job.comparison.reference
    names = [name for name, times in named.items() if times == (LINEARIZED,)]
    is_reference = reference in (LINEARIZED, (LINEARIZED,)) and reference not in named
    if not (names or is_reference):
        return job
    written = job.problem.points.written_of(design_of_job(job))
    changes: dict[str, Any] = {"reference": written} if is_reference else {}
    if names:
        changes["sets"] = {**named, **dict.fromkeys(names, written)}
    return job.with_changes(settings={"comparison": changes})


def design_of_job(job: Job) -> Times:
    """The linearized design of a job.

    Raises `ModelError` if its models cannot be loaded, or as `linearized_of`.
    """
    plain = job.model_copy(update={"filter": job.filter.chosen(PLAIN.name, 1, None, 1.0)})
    return design_of(job, evaluator_of(plain, *models_of_job(job)))


def _with_filter(job: Job, proposal: str, particles: int, built: Built | None = None) -> Job:
    """The job with a proposal and a number of particles, which are valid, instead of "auto".

    A job that was built tells how many particles move, and what that takes.
    """
    moved, steps = job.filter.moved_particles, 1.0
    if built is not None and PROPOSALS[proposal].moves:
        evaluator = self_consistent(built.evaluator)
        constants = constants_of(evaluator.believed, range(evaluator.horizon + 1))
        moved = moved_particles(job, len(constants))
        moving = replace(built.comparing, particles=moved, proposal=proposal)
        steps = steps_a_particle(evaluator, built.job.problem.feasible.regular(), moving)
    chosen = job.filter.chosen(proposal, particles, moved, steps)
    return job.model_copy(update={"filter": chosen})


def _built(job: Job, evaluator: Evaluator) -> Built:
    """The objects of a job whose models an evaluator has recorded; raises as `build`."""
    # To a filter that is wrong about the truth, one more measurement may do harm.
    feasible = job.problem.feasible
    is_wrong = knowing_truth(evaluator) is not evaluator
    smaller = feasible.smaller or (is_wrong and not feasible.counted)
    feasible = replace(feasible, smaller=smaller)
    study = study_of(job, feasible)
    searches = tuple(named_search(study, job, section, evaluator) for section in job.search)
    wanted = [comparing_of(job), Settings.from_job(job).estimation]
    wanted += [settings.estimation for search in searches for settings in search.all_settings]
    for work in later_of(job):
        wanted += work.estimations(job, evaluator)
    evaluator = replace(evaluator, estimations=tuple(dict.fromkeys(wanted)))
    evaluator = replace(evaluator, engine=_compiled_or_batched(evaluator))
    check_beside_truth(evaluator, comparing_of(job))
    built = Built(job, feasible, study, evaluator, searches)
    check_estimate_columns(
        [*built.names, *(e.part for e in later_of(job))], evaluator.model.named("z")
    )
    return built


def evaluator_of(
    job: Job, model: StateSpaceModel, filter_model: StateSpaceModel, clock: Clock | None = None
) -> Evaluator:
    """The evaluator of a job and its models, not yet compiled; raises as `build`.

    Another clock replaces that of the job: covariates of scenarios are constant from each of the
    job's instants to the next, and all instants have one weight.
    """
    problem, on = job.problem, clock or job.problem.clock
    _check_sensors(model, problem.points.sensors)
    scenarios = () if job.scenarios is None else job.scenarios.of_draws
    if clock is not None:
        from pfdist.problem.measurements import parameters_at  # noqa: PLC0415  needs pandas

        scenarios = tuple(
            replace(each, parameters=parameters_at(each.parameters, problem.clock, clock.times))
            for each in scenarios
        )
    knows_scenario = job.scenarios is not None and job.scenarios.filter == "told"
    times = on.times if problem.has_clock else None
    for place, each in (("model", model), ("model.filter", filter_model)):
        if times is None and each.reads_clock:
            has_dates = each.on_clock((0.0, 1.0)).reads_clock
            advice = (
                NO_DATES
                if has_dates
                else (
                    f"{NO_CLOCK} (a job's clock is problem.time_step, problem.time_unit or "
                    "problem.times)"
                )
            )
            raise ModelError(f"{place}: model {each.name} reads the clock: {advice}")
    try:
        evaluator = recorded_evaluator(
            model,
            filter_model,
            horizon=on.horizon,
            engine=job.filter.engine,
            estimations=(comparing_of(job), Settings.from_job(job).estimation),
            times=times,
            dates=on.dates_in_formulas,
            weights=problem.weights if clock is None else None,
            lag=problem.lag_on(on),
            delays=problem.waited_for if clock is None else (),
            others=[each.parameters for each in scenarios],
            knows_scenario=knows_scenario,
        )
        if not scenarios:
            return evaluator
        return replace(evaluator, scenarios=scenarios, knows_scenario=knows_scenario)
    except ModelError as error:
        if error.argument != "parameters":
            raise
        raise ModelError(f"scenarios.parameters: {error}") from error


def _check_sensors(model: StateSpaceModel, named: tuple[str, ...]) -> None:
    """Raise a `JobError` unless the job names the sensors of the model, in their order."""
    sensors = tuple(model.sensors)
    if named != sensors:
        raise JobError(
            f"problem.sensors must name the sensors of the model {model.name}, in their order: "
            f"{shown(list(sensors)) if sensors else 'it has none'}, got {shown(list(named))}"
        )


_USUAL_PARTICLES = 500  # where their number is not known yet


def _enough_particles(built: Built, proposal: str) -> int:
    """A number of particles that is enough for the regular times and the filter's own model."""
    # Imported here, so that workers, which know the number, need no pandas.
    from pfdist.results.particle_loss import SMALL, SMALL_AT_MOST  # noqa: PLC0415
    from pfdist.runner.particles import NUMBERS, enough_particles  # noqa: PLC0415

    evaluator, job = self_consistent(built.evaluator), built.job
    must = "filter.particles must be a number, got 'auto'"
    LOSS.check("filter.particles = 'auto'", job, evaluator)
    times, estimation = job.problem.feasible.regular(), replace(built.comparing, proposal=proposal)
    loss = enough_particles(evaluator, times, job.seed, estimation)
    if not loss.is_small:
        none = (
            f"with up to {loss.particles:,} particles, the particle loss is above {SMALL:.0%}, or "
            f"its limit above {SMALL_AT_MOST:.0%}; with {loss.particles:,} it is {loss.text}"
        ) * (loss.particles == NUMBERS[-1])  # else rare failures have ended the search
        found = ". ".join(filter(None, (none, loss.rare)))
        raise JobError(f"{must}: {found} ({job.path})")
    return loss.particles


def models_of_job(job: Job) -> Models:
    """The model of a job, and the model that its filter uses.

    A model comes from the run whose folder has the job, from an object given with the job, or from
    the name in the job.
    """
    kept = _kept_models(job)
    models = _given_models(job, kept)
    if kept:
        return models
    truth, believed = models
    with _naming("model.events"):
        given = with_events(job.model.events or {}, *([truth] if believed is truth else models))
        models = given[0], given[-1]
    if job.problem.given:
        models = both(models, partial(_with_given, job))
    if job.problem.sensings or any(way.model.works for each in models for way in each.ways):
        models = _sensed(job, models)
    if job.scenarios is None or not job.scenarios.is_learned:
        return models
    return _with_learned(job.scenarios, job.problem.feasible.horizon, *models)


@contextmanager
def _naming(key: str) -> Iterator[None]:
    """Errors of models begin with the key of the job that is wrong."""
    try:
        yield
    except ModelError as error:
        raise ModelError(f"{key}: {error}") from error


def both(models: Models, change: Callable[[StateSpaceModel], StateSpaceModel]) -> Models:
    """The model and that of the filter, both changed; the same one if they are equal."""
    model, believed = models
    return (truth := change(model)), truth if believed == model else change(believed)


def _with_given(job: Job, model: StateSpaceModel) -> StateSpaceModel:
    """The model whose parameters that come with each reading have a value for each instant."""
    values, instants = dict[str, Any](), job.problem.feasible.horizon + 1
    for name in job.problem.given or {}:
        if name not in model.parameters:
            rule = f"parameters of the model, {', '.join(model.parameters)}"
            raise ModelError(must_be("problem.given", rule, name, model.parameters))
        value = model.parameters[name]
        single = value[0] if isinstance(value, tuple) and len(value) == 1 else value
        values[name] = single if isinstance(single, tuple) else (single,) * instants
    return model.with_parameters(values)


def _sensed(job: Job, models: Models) -> Models:
    """The models whose sensors have limits, fail, or repeat, as the job says."""
    model = models[0]
    _check_sensors(model, tuple(job.problem.sensors or ()))
    key = f"problem.sensor{'s' * bool(model.sensors)}" if job.problem.sensings else "works"
    truth, believed = ([bool(way.model.works) for way in each.ways] for each in models)
    if truth != believed:
        raise ModelError("model.filter: the filter's model must have works where the model has it")
    with _naming(key):
        return both(models, partial(sensed, sensings=job.problem.sensings))


def _with_learned(
    scenarios: Scenarios, horizon: int, model: StateSpaceModel, believed: StateSpaceModel
) -> Models:
    """The models whose states have the parameters that the job's filter learns."""
    prior = scenarios.prior
    with _naming("scenarios.parameters"):
        truth = learned(model, prior)
        for each in prior if isinstance(prior, tuple) else ():
            check_lengths(each.parameters, horizon + 1, "", exactly=True)
        if believed == model and not scenarios.motion:
            return truth, truth
        return truth, learned(believed, prior, scenarios.motion)


def _given_models(job: Job, kept: Sequence[StateSpaceModel]) -> Models:
    """The two models of a job, without the parameters that its filter learns."""
    believed, model = job.model.filter, _model_of(job, "model", job.model, kept)
    if believed.name:
        return model, _model_of(job, "filter_model", believed, kept[1:])
    with _naming("model.filter"):
        if kept and kept[1] is not kept[0]:  # it has other parameters than the truth
            return model, kept[1].with_parameters(job.model.parameters | believed.parameters)
        return model, model.with_parameters(believed.parameters)


def _model_of(
    job: Job, place: str, section: Model | FilterModel, kept: Sequence[StateSpaceModel]
) -> StateSpaceModel:
    given = job.origin.models.get(place)
    try:
        if kept:
            model = kept[0]
        elif given is not None and given.name == section.name:
            model = given.model
        else:
            model = load_model(section.name, job.path.parent)
        return model.with_parameters(section.parameters) if section.parameters else model
    except ModelError as error:
        key = "model" if place == "model" else "model.filter"
        raise ModelError(f"{key}.{error.argument or 'name'}: {error}") from error


def _kept_models(job: Job) -> tuple[StateSpaceModel, ...]:
    """The models of the run that keeps a job; empty for another job."""
    # Imported here, so that workers, which need no files, need no pyarrow.
    from pfdist.store import check_entries, is_job_of_run, read_models, read_run  # noqa: PLC0415

    folder, section = job.path.parent, job.model
    if not is_job_of_run(job.path):
        return ()
    check_entries(folder)
    own = read_run(folder)[1].get("model", {})
    for key, got, name in (
        ("model.name", section.name, own.get("name")),
        ("model.filter.name", section.filter.name, own.get("filter", {}).get("name", "")),
        ("model.events", job.identity()["model"].get("events"), own.get("events")),
    ):
        if got != name:
            raise JobError(
                f"{key} must be {shown(name)}, the model of the run in {folder}, got {shown(got)}"
            )
    models = read_models(folder)
    if not job.problem.has_clock:
        return models
    clock = job.problem.clock  # of the job
    truth, believed = (replace(each, parameters=clock.without(each.parameters)) for each in models)
    return (truth, truth) if models[0] is models[1] else (truth, believed)


def _as_kept(evaluator: Evaluator, run: Path) -> Evaluator | None:
    """The evaluator with the models of a run; None if more than last digits differs."""
    # Workers need no pyarrow.
    from pfdist.store import check_entries, has_models, read_models  # noqa: PLC0415

    if not has_models(run):
        return None
    try:
        check_entries(run)
        truth, believed = read_models(run)
    except StoreError:  # whoever opens the run reports what is damaged
        return None
    if any(differences(truth, evaluator.model)) or any(differences(believed, evaluator.believed)):
        return None
    kept = with_functions(truth, evaluator.model), with_functions(believed, evaluator.believed)
    return replace(evaluator, model=kept[0], filter_model=kept[1])


def say_model_files(jobs: Iterable[Job], say: Callable[[str], Any]) -> None:
    """Announce the model files that jobs name, before they run."""
    from pfdist.store import is_job_of_run  # noqa: PLC0415  workers need no pyarrow

    files = dict.fromkeys(
        job.path.parent / name.rpartition(":")[0]
        for job in jobs
        for name in (job.model.name, job.model.filter.name)
        if ".py:" in name and not name.startswith(PYTHON) and not is_job_of_run(job.path)
    )
    for file in files:
        say(Detail(f"Running the model file {file}, which your job names"))


def _check_draws(job: Job, evaluator: Evaluator) -> None:
    """Raise a `ModelError` if a few draws of a user's model are not finite, or formulas fail."""
    home, _ = installed_models().get(job.model.name, ("", ""))
    for way in () if home.startswith("pfdist.") else reversed(evaluator.model.ways):
        few_draws(way.model, evaluator.horizon)


def _compiled_or_batched(evaluator: Evaluator) -> str:
    """Name of the engine: for "auto" the compiled one, or the batched one for a batched model.

    The formulas are compiled here, and workers on this machine find the result on disk.
    """
    if evaluator.engine == AUTO_ENGINE:
        evaluator = replace(evaluator, engine=COMPILED.name)
        for name, declared in declarations(evaluator.model, evaluator.believed).items():
            evaluator = replace(evaluator, engine=BATCHED.name)
            warnings.warn(
                f"model {name} is declared as {declared}: pfdist cannot see further, a run needs "
                "its code, which workers get by value, and the same bytes are promised for one "
                "machine and one set of versions",
                EngineWarning,
                stacklevel=5,
            )
    evaluator.compile(*evaluator.estimations)  # for every engine, so that mistakes end it at once
    if not has_fused_multiply_add():
        warnings.warn(WITHOUT_FMA, EngineWarning, stacklevel=5)
    return evaluator.engine


MOST_WORKERS = 1000  # on one machine; each is a thread, or a process of Ray


def check_pool(execution: Execution) -> None:
    """Raise a `JobError` if [execution] has settings that its pool does not take."""
    pool = execution.pool
    is_here = execution.address == "local" or not cluster_at_hand(execution.address)
    if execution.workers > MOST_WORKERS and (is_here or pool in ("threads", "processes")):
        raise JobError(
            f"execution.workers must be at most {MOST_WORKERS:,} on one machine, got "
            f"{execution.workers:,}: 0 is one for each core"
        )
    if pool == AUTO_POOL:
        return
    for name, without in (("workers", (0, 1)), ("address", ("",))):
        got = getattr(execution, name)
        if got not in without and name not in POOLS[pool].takes:
            others = ", ".join(repr(other) for other, kind in POOLS.items() if name in kind.takes)
            raise JobError(
                f"execution.pool = {pool!r}, which computes {POOLS[pool].description}, takes no "
                f"{name}, got {got!r}; pools that do: {others}"
            )


def chosen_pool(execution: Execution, *, threaded: bool) -> tuple[Execution, str]:
    """[execution] with a pool instead of ``auto``, and the reason for this pool.

    `threaded` says whether tasks release Python's lock, so that threads run in parallel. The reason
    is empty if [execution] names a pool.
    """
    if execution.pool != AUTO_POOL:
        return execution, ""
    address = execution.address or ("auto" if os.environ.get("RAY_ADDRESS") else "")
    if reason := cluster_at_hand(execution.address):
        return execution.model_copy(update={"pool": "ray", "address": address}), reason
    if threaded:
        return execution.model_copy(update={"pool": "threads"}), "no cluster is given"
    reason = "functions that are not compiled hold Python's lock"
    return execution.model_copy(update={"pool": "processes"}), reason


def make_pool(execution: Execution) -> Pool:
    """The pool that [execution] names; it starts when the caller enters it."""
    return POOLS[execution.pool].make(**execution.model_dump())


def check_estimate_columns(sets: Sequence[str], components: Sequence[Component]) -> None:
    """Raise a `JobError` if the estimates of two sets would have columns of one name.

    For example, the set ``a`` with the component ``b_c`` and the set ``a_b`` with the component
    ``c``.
    """
    owners = dict[str, tuple[str, str]]()
    for name in sets:
        for each in components:
            column = f"estimate_{name}_{each.suffix}"
            if column in owners:
                other, other_suffix = owners[column]
                raise JobError(
                    "estimates must have different columns, got the column "
                    f"{column!r} for {other_suffix!r} of the set {other!r} and for {each.suffix!r} "
                    f"of the set {name!r}: give a search, or a set of comparison.sets, another name"
                )
            owners[column] = name, each.suffix
