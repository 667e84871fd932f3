"""How a run was computed, how to load its tables, and how to cite."""

import json
from typing import Any

import pandas as pd
import tomli_w

from pfdist.analysis import read_recorded
from pfdist.reports.parts import Code, Facts, Section, Text
from pfdist.reports.subject import Subject, number_of, without_folder
from pfdist.store import run_key

_LOAD = """\
import pfdist

run = pfdist.open_run({name})  # the folder of the run
run.summary()
run.gains().describe()           # a row for each draw

# The tables are plain Parquet, so pandas alone reads them, too:
import pandas as pd

pd.read_parquet({table})
"""
_CITE = """\
A. Aspeel, A. Gouverneur, R. M. Jungers, B. Macq, "Optimal measurement budget allocation for
particle filtering", IEEE International Conference on Image Processing (ICIP), 2020.

The pfdist developers, "pfdist: when to measure", version {version}.
"""


def computed(subject: Subject) -> Section:
    """Give versions, seeds, processor and time of a run, and its job."""
    about, job = read_recorded(subject.run.path)
    return Section(
        "How it was computed",
        [
            Facts([*_versions(about), *_work(subject), *_identity(subject, about, job)]),
            Code(tomli_w.dumps(_sendable(_without_none(job))), "The job, with all its defaults"),
        ],
    )


def tables(subject: Subject) -> Section:
    """Say how to load the tables."""
    name = subject.run.path.name
    quoted = {"name": _quoted(name), "table": _quoted(f"{name}/tables/comparison")}
    return Section("How to load the tables", [Code(_LOAD.format(**quoted))])


def citation(subject: Subject) -> Section:
    """Say how to cite the method and the program."""
    version = subject.run.version
    told = "Please cite the paper whose method pfdist implements, and the program."
    return Section("How to cite", [Text(told), Code(_CITE.format(version=version))])


def _versions(about: dict[str, Any]) -> list[tuple[str, str]]:
    provenance = about["provenance"]
    libraries = ", ".join(f"{name} {version}" for name, version in provenance["libraries"].items())
    processor = provenance["processor"]
    return [
        ("pfdist", f"{about['pfdist']}, kernel {about['kernel']}"),
        ("Python and libraries", f"Python {provenance['python']}, {libraries}"),
        ("processor", f"{processor['model']} ({processor['compiled_for']})"),
        ("started", provenance["started"]),
    ]


def _work(subject: Subject) -> list[tuple[str, str]]:
    if not subject.run.has("timings"):
        return []
    rows = subject.run.timings()
    seconds = rows.groupby("session")["seconds"].sum()
    workers = rows[["node", "worker"]].drop_duplicates()
    facts = [("time of all workers", _seconds(seconds.sum()))]
    facts.append(("workers", f"{len(workers)}"))
    if len(seconds) > 1:
        *earlier, _ = seconds.sort_index()
        starts = number_of(len(seconds), "start")
        facts.append(("saved by resuming", f"{_seconds(sum(earlier))}, in {starts} of the program"))
    failures = int(rows["failures"].sum())
    if failures:
        facts.append(("tasks that failed and were done again", f"{failures:,}"))
    return facts


def _identity(
    subject: Subject, about: dict[str, Any], job: dict[str, Any]
) -> list[tuple[str, str]]:
    return [
        ("seed", str(job["seed"])),
        ("engine", about["engine"]),
        ("identity of the run", str(run_key(subject.run.path))),
    ]


def _sendable(job: dict[str, Any]) -> dict[str, Any]:
    """Give a job whose models are named without folders of this machine."""
    model = {**job["model"], "name": without_folder(job["model"]["name"])}
    if "filter" in model:
        model["filter"] = {**model["filter"], "name": without_folder(model["filter"]["name"])}
    return {**job, "model": model}


def _quoted(text: str) -> str:
    return json.dumps(text, ensure_ascii=False)


def _seconds(seconds: float) -> str:
    minutes, rest = divmod(seconds, 60)
    return f"{minutes:.0f} min {rest:.0f} s" if minutes else f"{rest:.1f} s"


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(entry) for key, entry in value.items() if entry is not None}
    if isinstance(value, list | tuple):
        return [_without_none(entry) for entry in value]
    return value if not (isinstance(value, float) and pd.isna(value)) else "nan"
