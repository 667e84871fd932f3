"""Whether a generation of a search fits into memory."""

import psutil

from pfdist.errors import JobError
from pfdist.job.job import Job
from pfdist.search.section import SearchSection

_BYTES_A_DRAW = 32  # the index and the MSE of a draw, in a worker's answer and in the table
_BYTES_A_SET = 1000  # the times, the evaluation and the row of a set
_SETS = {"population": 1, "chains": 2}
"""Settings for the number of sets in a generation, and how many sets each unit stands for."""


def check_memory(job: Job, section: SearchSection, draws: int) -> None:
    """Raise a `JobError` if a generation of a search does not fit into this machine's memory.

    Parameters
    ----------
    job : Job
    section : SearchSection
        A section of the job.
    draws : int
        Draws of an evaluation.
    """
    for key, sets in _SETS.items():
        count = section.settings.get(key, 0)
        wanted = count * sets * (_BYTES_A_SET + _BYTES_A_DRAW * draws)
        present = psutil.virtual_memory().total
        if wanted > present:
            raise JobError(
                f"search.{section.name}.{key} = {count} on {draws:,} draws each takes about "
                f"{wanted / 1e9:.3g} GB of memory, and this machine has {present / 1e9:.3g} GB: "
                f"take at most {present * count // wanted:,} ({job.path})"
            )
