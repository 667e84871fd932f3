"""Simulated systems, as a table with a picture."""

from pfdist.common.plugins import Command, Name, Plugin

_SIMULATE = Command(
    "pfdist.plugins.simulate.command:simulate",
    "Simulate a job's model, and write the systems as a table with a picture.",
    {
        "pfdist simulate jobs/plan.toml --out systems.csv": (
            "See the model before you plan: a table, and systems.png"
        ),
        "pfdist simulate jobs/plan.toml --out few.csv --draws 5": "Simulate five systems",
    },
)
PLUGIN = Plugin(
    commands={"Models": {"simulate": _SIMULATE}},
    words=("pfdist.plugins.simulate.words:WORDS",),
    names={
        "pfdist.plugins.simulate.question:simulate": Name(
            "models", "pfdist.simulate(problem, draws=10)"
        ),
    },
)
