"""Backtests: whether a plan keeps its promise, by real measurements."""

from pfdist.common.plugins import Command, Name, Plugin

_BACKTEST = Command(
    "pfdist.plugins.backtest.question:backtest",
    "Judge by real measurements whether a plan keeps its promise.",
    {
        "pfdist backtest jobs/plan.toml patients.csv": (
            "Compare the plan with two grids of evenly spaced times on real patients"
        ),
        "pfdist backtest jobs/plan.toml patients.csv --replicate patient --plan-each": (
            "Plan for each patient among the measurements that there are"
        ),
    },
)
PLUGIN = Plugin(
    commands={"Real data": {"backtest": _BACKTEST}},
    words=("pfdist.plugins.backtest.words:WORDS",),
    names={
        "pfdist.plugins.backtest.question:backtest": Name(
            "data", 'pfdist.backtest(run, "days.csv").promises'
        ),
    },
    capabilities=("pfdist.plugins.backtest.needs:PLAN_EACH",),
)
