"""Rules: measure when the filter is unsure, instead of at times that are fixed in advance."""

from pfdist.common.plugins import Command, Name, Plugin

_RULE = Command(
    "pfdist.plugins.rule.question:rule",
    "Measure when the filter is unsure, and compare this with the plan of a run.",
    {
        "pfdist rule jobs/plan.toml": "Tune a rule that measures as often as the plan",
        "pfdist rule jobs/plan.toml --hard": "Never measure more often than the plan",
    },
    resumes=True,
)
PLUGIN = Plugin(
    commands={"Real data": {"rule": _RULE}},
    names={
        "pfdist.plugins.rule.question:rule": Name("plan", "pfdist.rule(run).rule"),
        "pfdist.plugins.rule.rule_file:Rule": Name(
            "data", 'pfdist.Rule.load("results/plan/rule.json").decide(filter, t)'
        ),
    },
    capabilities=("pfdist.plugins.rule.needs:RULES",),
    parts={"rule": "what deciding on the way wins"},
    looks=("pfdist.plugins.rule.ruling:LOOK",),
    others={"online.next": "pfdist.plugins.rule.next_by_rule:next_by_rule"},
)
