"""Lists and tables of many runs, and figures of such tables."""

from pfdist.common.plugins import Command, Name, Plugin

_LIST = Command(
    "pfdist.plugins.runs.command:list_runs",
    "List the runs in a folder: how far each is, and what it has found.",
    {
        "pfdist list": "Show all runs in the folder results",
        "pfdist list results --json": "Print the same as JSON, for a program",
    },
)
_TABLE = Command(
    "pfdist.plugins.runs.command:table",
    "Put many runs into one table: what differs between them, and what they found.",
    {
        "pfdist table results/plan": "Show the results of a run, a row for each found set",
        "pfdist table results --out runs.csv": "Write all runs in a folder to a file",
    },
)
PLUGIN = Plugin(
    commands={"Runs": {"list": _LIST, "table": _TABLE}},
    words=("pfdist.plugins.runs.words:WORDS",),
    names={
        "pfdist.plugins.runs.listing:list_runs": Name("runs", 'pfdist.list_runs("results")'),
        "pfdist.plugins.runs.question:table": Name("runs", "pfdist.table(run)"),
    },
    plots=("pfdist.plugins.runs.figure:against",),
    others={"plot.folder": "pfdist.plugins.runs.figure:draw_folder"},
)
