"""Several numbers of measurements, or prices: how many are enough."""

from pfdist.common.plugins import Command, Name, Plugin

_BUDGET = Command(
    "pfdist.plugins.budget.question:budget",
    "Find times for each number or price, and compare them with evenly spaced ones.",
    {
        "pfdist budget jobs/plan.toml --measurements 5:41": (
            "Show how the error falls with 5, 6, ..., 41 measurements"
        ),
        "pfdist budget jobs/plan.toml --measurements 10:40:10 --results results/tens": (
            "Try only 10, 20, 30 and 40 measurements"
        ),
        "pfdist budget jobs/plan.toml --measurements 5:41 --target 25": (
            "Find the smallest number of measurements that reaches an error of 25"
        ),
    },
    resumes=True,
)
PLUGIN = Plugin(
    commands={"Plan": {"budget": _BUDGET}},
    words=("pfdist.plugins.budget.words:WORDS",),
    names={
        "pfdist.plugins.budget.question:budget": Name(
            "plan", "pfdist.budget(problem, range(5, 21), target=25)"
        ),
    },
    plots=("pfdist.plugins.budget.figure:budget",),
    figures=("pfdist.plugins.budget.figure",),
    capabilities=("pfdist.plugins.budget.needs:BUDGET",),
    sections={"budget": "pfdist.plugins.budget.section:Budget"},
)
