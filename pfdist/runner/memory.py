"""Whether what a search asks for at once can be held in memory."""

import psutil

from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.search.section import SearchSection

_BYTES_A_DRAW = 32  # its number and its error, in a worker's answer and in the table
_BYTES_A_SET = 1000  # its times, its evaluation and its row
_SETS = {"population": 1, "chains": 2}
"""Settings that say how many sets a search asks for at once, and how many sets each is."""


def check_memory(job: Job, section: SearchSection, draws: int) -> None:
    """Raise a `JobError` where a generation of a search cannot be held on this machine.

    Parameters
    ----------
    job : Job
    section : SearchSection
        Of the job.
    draws : int
        Of an evaluation.
    """
    for key, sets in _SETS.items():
        count = section.settings.get(key, 0)
        wanted = count * sets * (_BYTES_A_SET + _BYTES_A_DRAW * draws)
        there = psutil.virtual_memory().total
        if wanted > there:
            raise JobError(
                f"search.{section.name}.{key} = {count} on {draws:,} draws each takes about "
                f"{wanted / 1e9:.3g} GB of memory, and this machine has {there / 1e9:.3g} GB: "
                f"take at most {there * count // wanted:,} ({job.path})"
            )
