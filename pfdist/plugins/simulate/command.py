"""The command `simulate`."""

from collections.abc import Iterator, Sequence

from pfdist.plugins.simulate.question import write_simulated


def simulate(
    job: str,
    *,
    out: str,
    draws: int = 100,
    seed: int | None = None,
    changes: Sequence[str] = (),
) -> Iterator[str]:
    """Simulate a job's model, and write the systems as a table with a picture.

    The table has a row for each system and instant: draw, t, the states x, the measurements y that
    could be made, and the quantities of interest z. The picture, a PNG file beside it, has the band
    of 90 % of the systems, and four of them.

    Parameters
    ----------
    job : str
        A job file, as ``jobs/plan.toml``, or the folder of a run.
    out : str
        The file of the table: CSV, or Parquet if its name ends in ``.parquet``.
    draws : int
        Number of systems. A larger number begins with the same systems.
    seed : int, optional
        By default the seed of the job.
    changes : sequence of str, optional
        Other values of keys of the job, as ``seed=3 filter.particles=200``.
    """
    yield from map(str, write_simulated(job, out, draws, seed, changes))
