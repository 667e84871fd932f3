"""The page and the widget on which a user moves measurements by hand; nothing is stored.

`session` computes and words the answers, for the local page of `server` and for the notebook's
`widget`. Both show them by the module explore.js.
"""

from pfdist.common.plugins import Command, Name, Plugin

_EXPLORE = Command(
    "pfdist.plugins.explorer.command:explore",
    "Move the measurements by hand in a local page, and see the error at once.",
    {
        "pfdist explore jobs/plan.toml": "Open the page of a job, with the plan if it has one",
        "pfdist explore results/plan --no-browser": ("Only print the address of the page of a run"),
    },
)
PLUGIN = Plugin(
    commands={"Ask": {"explore": _EXPLORE}},
    names={
        "pfdist.plugins.explorer.widget:explore": Name("plan", "pfdist.explore(problem)"),
    },
    capabilities=("pfdist.plugins.explorer.needs:EXPLORE",),
)
