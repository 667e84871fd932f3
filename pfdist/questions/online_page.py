"""The gain of choosing each time when the last measurement is known."""

import math

from pfdist.common.parts import Figures, Section, Table, Text
from pfdist.common.percent import percent
from pfdist.questions.subject import ERROR_HEAD, Subject, effect, number_of
from pfdist.results.columns import COLUMNS, Row
from pfdist.results.online import is_online, online_draws

_SHOWN = ("name", "expected_mse", "gain_of_means", "positive_fraction")
_NOTHING = dict.fromkeys(_SHOWN)
_FIGURES = ("online_gain", "online_times", "online_draw")


def online(subject: Subject) -> Section | None:
    """Compare online times with the plan and with the reference."""
    if not is_online(subject.run):
        return None
    result = online_draws(subject.run).summary()
    plan = result["plan"]
    sets = [{"name": "online", **result}, plan, result["reference"]]
    rows = [Row(**_NOTHING | each) for each in sets]
    table = Table(
        f"Expected error on {number_of(result['draws'], 'draw')}",
        ("times", ERROR_HEAD, "online is lower by, %", "draws where online is lower, %"),
        [[COLUMNS[name].cell(row) for name in _SHOWN] for row in rows],
    )
    meaning = (
        "Each time is chosen when the measurement before it is known: the rest of the plan is made "
        f"anew from what the filter then believes. In {percent(result['differs_from_plan'], 0)} of "
        f"the draws the times differ from those of {plan['name']}."
    )
    return Section("Times chosen one after another", [Text(meaning), table, Figures(_FIGURES)])


def online_sentence(subject: Subject) -> str:
    """The gain of choosing each time when the last measurement is known; empty if unknown."""
    if not is_online(subject.run):
        return ""
    plan = online_draws(subject.run).summary()["plan"]
    if not math.isfinite(gain := plan["gain_of_means"]):
        return ""
    ends = [plan["gain_of_means_low"], plan["gain_of_means_high"]]
    lowers, left_open = effect(gain, ends)
    return (
        f"Choosing each time only when the last measurement is known {lowers}, compared with the "
        f"times of {plan['name']}. {left_open}"
    ).rstrip()
