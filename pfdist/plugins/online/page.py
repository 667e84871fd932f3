"""How online times compare with the plan, as a section and as a sentence."""

import math

from pfdist.common.changes import effect
from pfdist.common.parts import Figures, Section, Table, Text
from pfdist.common.percent import percent
from pfdist.plugins.online.draws import online_summary
from pfdist.problem.set_key import phrase_of
from pfdist.questions.subject import ERROR_HEAD, Subject, number_of
from pfdist.results.columns import COLUMNS, Row

_SHOWN = ("label", "expected_mse", "gain_of_means")
_NOTHING = dict.fromkeys(_SHOWN)


def online_section(subject: Subject) -> Section | None:
    """Online times compared with the plan and with the reference."""
    result = online_summary(subject.run)
    if result is None:
        return None
    plan = result["plan"]
    labels = subject.run.labels | {"online": "online"}
    sets = [{"name": "online", **result}, plan, result["reference"]]
    rows = [Row(**_NOTHING | each | {"label": labels[each["name"]]}) for each in sets]
    table = Table(
        f"Expected MSE on {number_of(result['draws'], 'draw')}",
        ("times", ERROR_HEAD, "online is lower by, %"),
        [[COLUMNS[name].cell(row) for name in _SHOWN] for row in rows],
    )
    meaning = (
        "Each time is chosen after the measurement before it: the rest of the plan is made again "
        f"from all measurements so far. In {percent(result['differs_from_plan'], 0)} of "
        f"the draws the times differ from those of {phrase_of(labels[plan['name']])}."
    )
    return Section(
        "Times chosen one after another", [Text(meaning), table, Figures(["online_times"])]
    )


def online_sentence(subject: Subject) -> str:
    """The gain of online times over the plan, in a sentence; empty if it is unknown."""
    if (found := online_summary(subject.run)) is None:
        return ""
    plan = found["plan"]
    if not math.isfinite(gain := plan["gain_of_means"]):
        return ""
    ends = [plan["gain_of_means_low"], plan["gain_of_means_high"]]
    label = phrase_of(subject.run.labels[plan["name"]])
    draws = number_of(found["draws"], "draw")
    said = effect(gain, ends, label)
    return f"Online times ({draws}): {said[0].lower()}{said[1:]}."
