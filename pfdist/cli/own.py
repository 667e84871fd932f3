"""Commands that differ from the functions of the library.

Each returns an answer, as the functions of `pfdist.questions` do, or yields lines or checks.
"""

import json
from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Literal, Unpack

from pfdist.common.arguments import path_argument
from pfdist.common.plugins import asked
from pfdist.errors import StoreError
from pfdist.questions.options import Options, with_options

if TYPE_CHECKING:  # each command imports what it needs, and no other command waits for that
    from pfdist.questions.foreseen import Foreseen
    from pfdist.results import Run


@with_options
def plan(
    job: str,
    *,
    results: str | None = None,
    search: str = "relaxation",
    changes: Sequence[str] = (),
    bound_draws: int | None = None,
    reuse: Sequence[str] = (),
    export: str | None = None,
    against: Sequence[str] | None = None,
    dry_run: bool = False,
    **options: Unpack[Options],
) -> "Run | Foreseen":
    """Find measurement times for a job's problem, and prove how good they are.

    One search finds them. They are compared with evenly spaced times on fresh draws. A lower bound
    proves how much better any other times can be. Quick estimates show how many evenly spaced
    measurements do as well, and what deciding on the way wins. The answer also has the error of an
    analysis afterwards, with all measurements. The same command resumes where it was stopped.

    Parameters
    ----------
    job : str
        A job file, as ``jobs/plan.toml``, or the folder of a run. Searches of the job are ignored.
    results : str, optional
        Folder of the run; by default ``results/NAME`` of a job ``NAME.toml``, or
        ``results/NAME-plan`` if the job lists searches, or ``results/NAME-against``.
    search : str
        Method of the search. Its settings are keys of the job, as ``search.relaxation.paths=16``.
    changes : sequence of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    bound_draws : int
        Draws of the lower bound, by default 480; 0 for no bound. For several numbers of
        measurements there is a bound only if this is given. One that would take more than about
        five minutes of a core is left out, and a line names the command that proves it.
    reuse : sequence of str, optional
        Folders of other runs, whose evaluations are taken, not computed again; give it once for
        each.
    export : str, optional
        Also write the plan into this file: ``.csv`` for a spreadsheet, ``.ics`` for a diary.
    against : sequence of str, optional
        Was last year good? A table of its times, ``@last.csv``, or sets as for `pfdist.compare`,
        with which the plan is compared. Where the job counts measurements, the plan has as many as
        the first of these sets.
    dry_run : bool
        Print the particle-steps that are usual, by what they are for, about how many minutes a core
        of this machine takes for them, and the size on disk; compute nothing. A proof that `plan`
        would leave to `pfdist bound` does not count.
    options
        See `Options`.
    """
    from pfdist.questions.plan import plan as planned

    if dry_run:
        from pfdist.questions.foreseen import foreseen_work

        return foreseen_work(job, search, changes, bound_draws, against)
    return planned(job, results, search, changes, bound_draws, reuse, export, against, **options)


def status(run: str, *, export: str | None = None) -> "Run":
    """Show how far a run is and what it has found.

    Parameters
    ----------
    run : str
        Folder of a run.
    export : str, optional
        Also write the plan into this file: ``.csv`` for a spreadsheet, ``.ics`` for a diary.
    """
    from pfdist.results import open_run

    opened = open_run(run)
    if export is not None:
        opened.export(export)
    return opened


def plot(run: str) -> Iterator[str]:
    """Draw the figures of a run, or the figure of a sweep, as PNG, SVG and PDF.

    Parameters
    ----------
    run : str
        Folder of a run, or of a sweep.
    """
    from pfdist.pages.plots import draw_figures
    from pfdist.results import open_run
    from pfdist.store import holds_run
    from pfdist.store.folder import FORMATS

    path = path_argument("run", run)
    if (draw := asked("plot.folder")) and not holds_run(path):
        yield from map(str, draw(path))
    else:
        yield from map(str, draw_figures(open_run(path), formats=FORMATS))


def schema() -> str:
    """Print the JSON schema of job files and sweep files, for an editor.

    An editor with it completes and checks keys while you write: see docs/install.md.
    """
    from pfdist.problem.job_schema import job_schema

    return json.dumps(job_schema(), indent=1)


def verify(run: str) -> Iterator[str]:
    """Check every byte, row and key of a run.

    Parameters
    ----------
    run : str
        Folder of a run.
    """
    from pfdist.results import open_run
    from pfdist.results.sets import fault_of_summary
    from pfdist.store.folder import SUMMARY
    from pfdist.store.verify import verify_run

    path = path_argument("run", run)
    damages = list(verify_run(path))
    yield from damages
    if damages:
        raise StoreError(f"{path}: problems found: {len(damages)}")
    opened = open_run(path)
    if fault := fault_of_summary(opened):
        raise StoreError(f"{path / SUMMARY} {fault}: remove it")
    parts = len(list(path.glob("parts/*/*.parquet")))
    is_finished = opened.state == "finished"
    unfinished = "" if is_finished else f"; not finished ({opened.state}, {parts} parts)"
    yield f"{run}: all files are unchanged, and no row or key is missing{unfinished}"


def models() -> Iterator[tuple[str, str]]:
    """List the models that a job can name."""
    from pfdist.models import installed_models

    installed = installed_models()
    width = max(map(len, installed))
    for name in sorted(installed):
        try:
            description = import_module(installed[name][0]).__doc__ or ""
        except Exception as error:  # a package that was installed beside pfdist
            description = f"cannot be loaded: {type(error).__name__}: {error}"
        yield f"{name:{width}}  ", description.partition(chr(10))[0]


def completion(shell: Literal["bash", "zsh", "fish"]) -> str:
    """Print a script by which a shell completes commands, options and files.

    Parameters
    ----------
    shell : str
        Your shell.
    """
    from pfdist.cli.program import program

    return program().generate_completion(shell=shell)
