"""Results on disk: a CSV a table, a figure a benchmark, and one README of what they say.

The first lines of a CSV, behind ``#``, say when and on which machine it was measured, so that the
README can be made again from the tables alone: benchmarks may be run one by one.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Protocol

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from benchmarks.measure import Say
from pfdist.plots.style import STYLE

Tables = dict[str, pd.DataFrame]


class Benchmark(Protocol):
    """What a module that measures something has.

    ``TITLE``, ``TABLES`` (the names of what it measures, its own first), and three functions.
    """

    TITLE: str
    TABLES: tuple[str, ...]

    def measure(self, quick: bool, say: Say) -> Tables:
        """Measure; `quick` proves only that it works."""

    def summary(self, tables: Tables) -> str:
        """Say in Markdown what the tables say."""

    def plot(self, tables: Tables) -> Figure:
        """Draw what the tables say."""


def save(
    folder: Path, name: str, benchmark: Benchmark, tables: Tables, provenance: Mapping[str, str]
) -> None:
    """Write the tables of a benchmark and its figure.

    Parameters
    ----------
    folder : Path
        Made if need be.
    name : str
        The benchmark's.
    benchmark : Benchmark
    tables : dict of DataFrames
    provenance : mapping of str to str
        See `machine.provenance`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for table, rows in tables.items():
        head = "".join(f"# {key}: {value}\n" for key, value in provenance.items())
        text = head + rows.to_csv(index=False, float_format="%.6g")
        (folder / f"{table}.csv").write_text(text, encoding="utf-8")
    with mpl.rc_context(STYLE):
        benchmark.plot(tables).savefig(folder / f"{name}.png", bbox_inches="tight")


def write_readme(folder: Path, benchmarks: Mapping[str, Benchmark]) -> str:
    """Write what the tables in the folder say.

    Parameters
    ----------
    folder : Path
    benchmarks : mapping of str to Benchmark
        Those that exist; one that was never measured is left out.

    Returns
    -------
    str
        The text.
    """
    parts: list[str] = []
    machine = ""
    for name, benchmark in benchmarks.items():
        files = [folder / f"{table}.csv" for table in benchmark.TABLES]
        if not all(file.exists() for file in files):
            continue
        tables = {file.stem: pd.read_csv(file, comment="#") for file in files}
        known = _provenance(files[0])
        on = f"{known['machine']}. {known['versions']}."
        if on != machine:  # said again only where it changes
            parts.append(f"Measured on: {on}\n")
            machine = on
        parts += [
            f"## {benchmark.TITLE}\n",
            f"{benchmark.summary(tables)}\n",
            f"{known['date']}.\n",
            f"![{benchmark.TITLE}]({name}.png)\n",
        ]
    title = "# Benchmarks\n\nWritten by `python -m benchmarks`; the CSV files hold every figure.\n"
    text = "\n".join([title, *parts])
    (folder / "README.md").write_text(text, encoding="utf-8")
    return text


def markdown(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Lay out a table; the first column is text, the others numbers.

    Examples
    --------
    >>> print(markdown(["who", "ns"], [["us", "1.7"]]))
    | who | ns |
    |---|---:|
    | us | 1.7 |
    """
    names = list(header)
    lines = [names, *(list(row) for row in rows)]
    text = [f"| {' | '.join(line)} |" for line in lines]
    return "\n".join([text[0], "|---|" + "---:|" * (len(names) - 1), *text[1:]])


def with_range(values: pd.Series, form: str) -> str:
    """Say the median of some values, and in brackets the least and the largest.

    Examples
    --------
    >>> with_range(pd.Series([3.0, 1.0, 2.0]), ".1f")
    '2.0 (1.0 to 3.0)'
    """
    return f"{values.median():{form}} ({values.min():{form}} to {values.max():{form}})"


def _provenance(file: Path) -> dict[str, str]:
    with file.open(encoding="utf-8") as lines:
        heads = [line[1:].strip().partition(": ") for line in lines if line.startswith("#")]
    return {key: value for key, _, value in heads}
