"""Sweeps: a job at many values of its keys, with the same workers."""

from pfdist.common.plugins import Command, Name, Plugin

_SWEEP = Command(
    "pfdist.plugins.sweep.command:sweep",
    "Run a job at many values of its keys, with the same workers.",
    {
        "pfdist sweep jobs/plan.toml --over seed=1:3": (
            "Plan with three seeds, with the same workers"
        ),
        "pfdist sweep jobs/plan.toml --over seed=1:2 --over filter.particles=100,500": (
            "Run every combination of two keys"
        ),
        "pfdist sweep jobs/budgets.toml --dry-run": "List the points of a sweep file",
        "pfdist sweep jobs/budgets.toml --part 3/12": "Compute the third of twelve parts",
    },
    resumes=True,
)
PLUGIN = Plugin(
    commands={"Plan": {"sweep": _SWEEP}},
    words=("pfdist.plugins.sweep.words:WORDS",),
    names={
        "pfdist.plugins.sweep.question:Sweep": Name("plan", "sweep.table()"),
        "pfdist.plugins.sweep.question:sweep": Name(
            "plan", 'pfdist.sweep("jobs/plan.toml", {"seed": range(1, 11)})'
        ),
    },
    files=("pfdist.plugins.sweep.sweep_file:SweepFile",),
)
