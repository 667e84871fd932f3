"""Checks of a model, and the number of particles that is enough."""

from pfdist.common.plugins import Command, Name, Plugin

_CHECK = Command(
    "pfdist.plugins.check.command:check_model",
    "Find what is wrong with a model.",
    {
        "pfdist check-model mine.py:model": "Check the object `model` in the file mine.py",
        "pfdist check-model ungm --horizon 20": "Check a model that ships, on short draws",
        "pfdist check-model jobs/plan.toml": "Check the models of a job, with its parameters",
        'pfdist check-model mine.py:model --times "0:12:0.5 14 18"': ("Check a model on a clock"),
    },
)
PLUGIN = Plugin(
    commands={"Models": {"check-model": _CHECK}},
    words=("pfdist.plugins.check.words:WORDS",),
    names={
        "pfdist.plugins.check.question:check_model": Name("models", "pfdist.check_model(problem)"),
        "pfdist.plugins.check.losses:particle_losses": Name(
            "models", "pfdist.particle_losses(problem, (50, 200, 1000))"
        ),
    },
    plots=("pfdist.plugins.check.figure:particle_losses",),
)
