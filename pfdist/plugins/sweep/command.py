"""The command `sweep`: a dry run, or the function of the library."""

from collections.abc import Mapping, Sequence
from typing import Any, Unpack

from pfdist.errors import ArgumentError
from pfdist.plugins.sweep import question
from pfdist.plugins.sweep.question import ForeseenPoints, Sweep
from pfdist.questions.options import Options, with_options
from pfdist.runner.progress import silent


@with_options
def sweep(
    job: str,
    *,
    over: Mapping[str, Sequence[Any]] | None = None,
    results: str | None = None,
    changes: Sequence[str] = (),
    bound_draws: int = 0,
    part: tuple[int, int] | None = None,
    dry_run: bool = False,
    **options: Unpack[Options],
) -> Sweep | ForeseenPoints:
    """Run a job at many values of its keys, with the same workers.

    Parameters
    ----------
    job : str
        A sweep file, which names a job and values of its keys; or a job file, with --over.
    over : mapping, optional
        A key of the job with its values, as seed=1:10 or model.parameters.NAME=0.5,1; give the
        option once for each key. Every combination is a point.
    results : str, optional
        Folder of the sweep; by default ``results/NAME`` of a sweep file ``NAME.toml``, or
        ``results/NAME-sweep`` of a job.
    changes : sequence of str, optional
        Other values of keys of the job, at all points.
    bound_draws : int
        Number of draws of the lower bound that is proved at each point; 0 for no bound.
    part : tuple of two int, optional
        Compute every N-th point, from the K-th, and no other, as tasks of a batch array do. Then
        the same command without --part makes the table and the figure of the whole sweep.
    dry_run : bool
        Print the points, their work, estimated from a few draws, and how many parts are worthwhile;
        compute no point.
    options
        See `Options`.
    """
    if dry_run and part is not None:
        raise ArgumentError("--part and --dry-run exclude each other: a dry run computes no point")
    if dry_run:
        return question.foreseen(
            job, over or {}, results=results, changes=changes,
            progress=options.get("progress"), say=options.get("say", silent),
        )  # fmt: skip
    return question.sweep(
        job, over or {}, results=results, changes=changes, bound_draws=bound_draws, part=part,
        **options,
    )  # fmt: skip
