"""A job and a model to begin with."""

from pfdist.common.plugins import Command, Plugin

_INIT = Command(
    "pfdist.plugins.init.command:init",
    "Write a job and a model that run, to begin with.",
    {
        "pfdist init": "Write mine.toml and mine.py, with the usual choices as comments",
        "pfdist init lake": "Write lake.toml and lake.py",
    },
)
PLUGIN = Plugin(commands={"Models": {"init": _INIT}})
