"""Times that are chosen one after another, each after the measurement before it is known."""

from pfdist.common.plugins import Command, Name, Plugin

_NEXT = Command(
    "pfdist.plugins.online.next_time:next_time",
    "Choose when to measure a system next, from the measurements so far.",
    {
        "pfdist next jobs/plan.toml patient.csv": "Choose the patient's next measurement time",
        "pfdist next jobs/plan.toml patient.csv --now 17": (
            "The same, if nothing was measured since, up to t = 17"
        ),
        "pfdist next jobs/plan.toml patient.csv --rule": "Measure by the run's rule",
    },
)
_ONLINE = Command(
    "pfdist.plugins.online.question:online",
    "Choose times one after another, and compare them with times found in advance.",
    {
        "pfdist online jobs/online.toml": (
            "Compare times chosen one after another with times found in advance"
        ),
        "pfdist online jobs/plan.toml --draws 200": (
            "The same for a job without a section [online], on few draws"
        ),
    },
    resumes=True,
)
PLUGIN = Plugin(
    commands={"Real data": {"next": _NEXT, "online": _ONLINE}},
    words=("pfdist.plugins.online.words:WORDS",),
    names={
        "pfdist.plugins.online.question:online": Name("plan", 'pfdist.online("jobs/online.toml")'),
        "pfdist.plugins.online.next_time:next_time": Name(
            "data", 'pfdist.next_time(run, "patient.csv")'
        ),
        "pfdist.plugins.online.planner:Planner": Name(
            "data", "pfdist.Planner(problem).next_time()"
        ),
    },
    plots=("pfdist.plugins.online.figure:online_shares",),
    figures=("pfdist.plugins.online.figure",),
    capabilities=("pfdist.plugins.online.needs:ON_THE_WAY",),
    sections={"online": "pfdist.plugins.online.section:Online"},
    parts={"online": "online times"},
    later={"online": "pfdist.plugins.online.driver:LATER"},
    summaries={"online": "pfdist.plugins.online.draws:online_summary"},
    answers=("pfdist.plugins.online.page:online_section",),
    sentences=("pfdist.plugins.online.page:online_sentence",),
    others={"rule.beside": "pfdist.plugins.online.draws:online_errors"},
)
