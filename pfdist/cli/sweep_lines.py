"""How the points of a sweep are printed."""

from argparse import Namespace
from typing import TYPE_CHECKING

import pandas as pd

from pfdist.cli.aligned import Column, aligned
from pfdist.cli.answers import print_records
from pfdist.cli.runs_lines import runs_lines
from pfdist.errors import one_line
from pfdist.store.folder import REPORT, has_report

if TYPE_CHECKING:
    from pfdist.api.sweep import Sweep

_BILLION = 1e9


def print_foreseen(points: pd.DataFrame, options: Namespace) -> None:
    """Print the points of a sweep and their work.

    Parameters
    ----------
    points : DataFrame
        As `pfdist.api.foreseen.foreseen` gives it.
    options : Namespace
        The parsed arguments.
    """
    if options.json:
        print_records("points", points, options)
        return
    steps = [f"{number / _BILLION:.3f}" for number in points["steps"]]
    columns = [
        Column("point", list(points["point"])),
        Column("state", list(points["state"])),
        Column("billion steps", steps, is_number=True),
    ]
    print("\n".join(aligned(columns)))
    left = points.loc[points["state"] != "finished", "steps"].sum() / _BILLION
    told = f"{len(points)} points; about {left:.3f} billion particle-steps are left to do"
    if "judging_steps" in points:
        told += f", and at most {points['judging_steps'].sum() / _BILLION:.3f} billion to judge"
    print(f"\n{told}")


def print_sweep(finished: "Sweep", options: Namespace) -> None:
    """Print the table of a sweep, and where its runs and its report are."""
    table = finished.table() if finished.runs else pd.DataFrame()
    if options.json:
        print_records("rows", table, options)
        return
    if finished.runs:
        print("\n".join(runs_lines(table)))
    if finished.busy:
        print(f"\nother processes compute {', '.join(finished.busy)}")
    there = [f"runs: {finished.path}"]
    if has_report(finished.path):
        there.append(f"report: {finished.path / REPORT}")
    print(f"\n{one_line('   '.join(there))}")
