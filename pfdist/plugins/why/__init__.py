"""The worth of each measurement of a run, and how exactly it must be kept."""

from pfdist.common.plugins import Command, Name, Plugin

_WHY = Command(
    "pfdist.plugins.why.question:why",
    "Show what each measurement of a run is worth, and how exactly it must be kept.",
    {
        "pfdist why jobs/plan.toml": "Show what each measurement of the plan is worth",
        "pfdist why jobs/plan.toml --draws 20000": "Show it more precisely",
        "pfdist why results/plan": "Name the run by its folder",
    },
)
PLUGIN = Plugin(
    commands={"Ask": {"why": _WHY}},
    names={
        "pfdist.plugins.why.question:why": Name("plan", "pfdist.why(run).worth"),
    },
    plots=("pfdist.plugins.why.figures:error_profile", "pfdist.plugins.why.figures:worth"),
    figures=("pfdist.plugins.why.figures",),
    capabilities=("pfdist.plugins.why.needs:WHY",),
    parts={"why": "what each measurement is worth"},
    chapters=("pfdist.plugins.why.page:worth_section",),
)
