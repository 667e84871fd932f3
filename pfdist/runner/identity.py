"""The identity of a run: its folder is opened, recovered and checked."""

import contextlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from importlib.metadata import version
from itertools import count
from pathlib import Path
from typing import Any

from pfdist.common.dotted_keys import leaves
from pfdist.common.measurement_times import CLOCK, DATES
from pfdist.common.plugins import hooked
from pfdist.errors import RunMismatchError, StoreError, shown_text
from pfdist.filters.engines import AUTO
from pfdist.filters.particle_filter import KERNEL_VERSION
from pfdist.models.recorded import differences
from pfdist.models.written import text_of_models
from pfdist.problem.job import Job, job_toml
from pfdist.problem.points import Points
from pfdist.results import open_run, read_recorded
from pfdist.runner.build import Built
from pfdist.runner.provenance import provenance
from pfdist.store import (
    SCHEMA_VERSION,
    Store,
    TimeColumns,
    check_entries,
    check_models,
    held,
    holds_run,
    key_of,
    read_models,
    read_run,
    run_key,
    run_text,
    write_about,
)
from pfdist.store.about import check_version_of, recorded_key
from pfdist.store.folder import ABOUT, FILES, MODELS
from pfdist.store.listing import read_listing

_HASH = re.compile("[0-9a-f]{16,64}")
_LENGTHS = tuple(f"{key}.draws" for key in ("comparison", *hooked("sections")))
"""Keys of a job that set the length of a run; see `_may_change`."""


@contextlib.contextmanager
def opened(path: Path, built: Built) -> Iterator[Store]:
    """A run's folder, locked for computing: it is made, or checked to hold this run.

    The folder is locked, leftovers of a killed process are removed, and the files that identify the
    run are written.

    Raises `RunMismatchError` if the folder holds a different run. Raises `StoreError` if another
    process is computing the run, if a file is damaged, if the folder cannot be read or written, or
    if it holds anything but a run.
    """
    identity = _identity(built)
    key = key_of(identity, built.job.identity())
    _check_free(path, key)
    with held(path):
        check_entries(path)
        _check_free(path, key)
        lacks = [name for name in ABOUT if not (path / name).exists()]
        # Until the folder is known to hold this run, nothing in it is changed.
        if not lacks and (run_key(path) or recorded_key(path)) != key:
            if not (path / FILES).exists():
                raise StoreError(
                    f"{path} lacks {FILES} and holds a different or changed job: give --results "
                    f"{_free(path)}",
                    argument="results",
                )
            _check_same(path, built, identity, 0)
        store = store_of(built, path, key)
        store.recover()
        committed = _committed(store)
        if not lacks:
            check_models(path)
            _check_same(path, built, identity, committed)
        elif built.job.comparison.draws < committed:
            raise _too_few(path, built.job, committed)
        store.check_published()
        _write_about(path, built, identity, key)
        yield store


def is_sealed(path: Path, built: Built) -> bool:
    """Whether a read-only folder holds the finished run of exactly this job.

    Raises `RunMismatchError` if it holds a different run.
    """
    if not holds_run(path) or os.access(path, os.W_OK):
        return False
    check_entries(path)
    _check_same(path, built, _identity(built), _committed(store_of(built, path)))
    run = open_run(path)
    return run.job == built.job.identity() and run.state == "finished"


@lru_cache(maxsize=8)
def time_columns(points: Points) -> TimeColumns:
    """The times and texts in place of instants and points in tables.

    Here the unit of a clock and the start of its dates become a text, that of the CF conventions;
    `pfdist.pages.panel.clock_of_table` reads it.
    """
    clock = points.clock
    written: Sequence[Any] = ()
    if points.sensors or clock.has_dates:
        written = points.written_of(range(points.number))
    elif points.delays:
        written = [*map(float, points.written_of(range(points.number)))]
    dates = map(clock.text, clock.times) if clock.has_dates else ()
    return TimeColumns(clock.times, clock.time_unit, tuple(written), tuple(dates), clock.counts)


def store_of(built: Built, path: Path, run_key: str | None = None) -> Store:
    """The store of a run of this job, whose tables have times on the job's clock."""
    points = built.job.problem.points
    if points.clock.counts and not (points.sensors or points.delays):
        return Store(path, run_key)
    return Store(path, run_key, time_columns(points))


def _committed(store: Store) -> int:
    return max((each.stop for each in store.draws("comparison")), default=0)


def _write_about(path: Path, built: Built, identity: dict[str, Any], key: str) -> None:
    """Write what is missing of job.toml, model.json and run.json; job.toml also with more draws."""
    job, texts = built.job.identity(), dict[str, str]()
    if not (path / MODELS).exists():
        texts[MODELS] = text_of_models(built.evaluator.model, built.evaluator.believed)
    if not holds_run(path):
        texts["run.json"] = run_text({**identity, "provenance": provenance(built)})
    if texts or not (path / "job.toml").exists() or read_recorded(path)[1] != job:
        write_about(path, key, {**texts, "job.toml": job_toml(job)})


def estimations(built: Built) -> dict[str, dict[str, Any]]:
    """How each search estimates errors, which a job does not say."""
    if not built.evaluator.has_particles:
        return {}
    return {search.name: search.settings.estimation.recorded for search in built.searches}


def _identity(built: Built) -> dict[str, Any]:
    return {
        "schema_version": SCHEMA_VERSION,
        "pfdist": version("pfdist"),
        "kernel": KERNEL_VERSION,
        "engine": built.evaluator.engine,
        **dict(zip(("model", "filter_model"), built.evaluator.keys, strict=True)),
        "estimations": estimations(built),
    }


def check_same_job(path: Path, recorded: Mapping[str, Any], job: Job) -> None:
    """Raise `RunMismatchError` if a question about a run comes with a different job.

    `recorded` is the run's own job. Numbers of draws may differ, because the question uses those of
    the run. So may a number of particles that the run has found itself.
    """
    found = {"filter.particles": job.filter.particles, "filter.proposal": job.filter.proposal}
    found["filter.moved_particles"] = job.filter.moved_particles or AUTO
    left = (*_LENGTHS, *(key for key, value in found.items() if value == AUTO))
    changes = [
        f"{key}: {_short(was)} -> {_short(is_now)}"
        for key, was, is_now in _changes(recorded, job.identity())
        if key not in left
    ]
    if changes:
        raise _mismatch(path, changes, f"ask about {path}, or plan this job with")


def check_same_models(path: Path, built: Built) -> None:
    """Raise `RunMismatchError` unless the built models are those of a run."""
    changes = changed_models(path, built)
    if changes:
        message = f"the model has changed since {path} was computed. In the run -> now"
        raise RunMismatchError(message, tuple(f"{key}: {how}" for key, how in changes.items()))


def changed_models(path: Path, built: Built) -> dict[str, str]:
    """The differences between the built models and those of a run, by the name of the part."""
    run, evaluator = read_run(path)[0], built.evaluator
    if (run["model"], run["filter_model"]) == evaluator.keys:
        return {}
    truth, believed = read_models(path)
    of_clock = (*CLOCK, *DATES) if evaluator.times is not None else ()  # the job's
    clock = {f"parameters.{name}" for name in of_clock}
    of_truth, of_filter = (
        {key: text for key, text in differences(*models) if key not in clock}
        for models in ((truth, evaluator.model), (believed, evaluator.believed))
    )
    return {f"model.{key}": text for key, text in of_truth.items()} | {
        f"model.filter.{key}": text for key, text in of_filter.items() if of_truth.get(key) != text
    }


def _check_free(path: Path, key: str) -> None:
    """Raise a `StoreError` if a folder lacks one of `ABOUT`, and holds no run of this key.

    A start that was killed before it wrote run.json leaves files.json, and perhaps its
    job.toml and model.json.
    """
    if path.exists() and not path.is_dir():
        raise StoreError(f"results must be a folder, got the file {path}", argument="results")
    check_version_of(path)
    strange = {entry.name for entry in path.glob("[!.]*")}
    if strange >= {*ABOUT} or not strange:
        return
    with contextlib.suppress(StoreError):  # a damaged files.json may be a file of the user
        listing = read_listing(path)
        if listing is not None and listing.run == key:
            return
        if listing is not None:
            is_left = listing.about.get("job.toml") and not any(path.glob("[pt]a*/*/*"))
            strange -= {FILES, *([*ABOUT, "parts", "tables"] if is_left else [])}
    if strange:
        raise StoreError(
            f"results must be a new folder, an empty one or a run's, got {path} "
            f"with {', '.join(sorted(strange)[:3])} in it",
            argument="results",
        )


def _check_same(path: Path, built: Built, identity: dict[str, Any], committed: int) -> None:
    (run, old_job), job = read_run(path), built.job
    others = identity.keys() - {"model", "filter_model"}
    old = {"job": old_job, **{name: run[name] for name in sorted(others)}}
    new = {"job": job.identity(), **{name: identity[name] for name in sorted(others)}}
    changes = changed_models(path, built)
    for key, was, is_now in _changes(old, new):
        if _may_change(key, was, is_now, committed):
            continue
        before = f"{committed} committed" if key == "job.comparison.draws" else _short(was)
        changes[key.removeprefix("job.")] = f"{before} -> {_short(is_now)}"
    differences = [f"{name}: {change}" for name, change in sorted(changes.items())]
    # The estimations of searches follow from the job; name them only if nothing else differs.
    causes = [line for line in differences if not line.startswith("estimations.")] or differences
    if causes and all(line.startswith("comparison.draws: ") for line in causes):
        raise _too_few(path, job, committed)
    if causes:
        raise _mismatch(path, causes)


def _changes(old: Mapping[str, Any], new: Mapping[str, Any]) -> Iterator[tuple[str, Any, Any]]:
    """Yield the key and both values of every leaf that differs."""
    before, after = dict(leaves(old)), dict(leaves(new))
    for key in sorted(before.keys() | after.keys()):
        was, is_now = before.get(key, "nothing"), after.get(key, "nothing")
        if json.dumps(was) != json.dumps(is_now):  # the key tells 1 from 1.0, and 0.0 from -0.0
            yield key, was, is_now


def _short(value: Any) -> str:
    """A value as an error shows it: the first digits of a hash; long values without the middle."""
    if isinstance(value, str) and _HASH.fullmatch(value):
        return value[:8]
    return shown_text(str(value))


def _mismatch(path: Path, differences: list[str], remedy: str = "give") -> RunMismatchError:
    return RunMismatchError(
        f"{path} holds a different run: {remedy} --results {_free(path)}. In the run -> now",
        tuple(differences),
    )


def _free(path: Path) -> Path:
    """The first of the folders NAME-2, NAME-3, ... that does not exist."""
    named = (path.with_name(f"{path.name}-{number}") for number in count(2))
    return next(each for each in named if not each.exists())


def _too_few(path: Path, job: Job, committed: int) -> StoreError:
    return StoreError(
        f"comparison.draws must be at least the {committed} draws that {path} has compared, got "
        f"{job.comparison.draws}; for fewer draws, give --results {_free(path)}"
    )


def _may_change(key: str, was: Any, is_now: Any, committed: int) -> bool:
    """Whether a run may resume with this change: more draws."""
    if "nothing" in (was, is_now) or key.removeprefix("job.") not in _LENGTHS:
        return False
    return bool(is_now >= (committed if key == "job.comparison.draws" else was))
