"""The options that computing functions share: shown by their signatures, and checked by name."""

import inspect
from collections.abc import Callable
from typing import Any

import pytest

import pfdist
from pfdist.cli.words import WORDS, Word
from pfdist.common.arguments import columns_argument, names_argument, paths_argument, sets_argument
from pfdist.errors import ArgumentError, JobError
from pfdist.plugins.sweep.sweep_file import read_sweep
from pfdist.problem.problem import as_job
from pfdist.questions.options import Options
from pfdist.questions.plan import of_as_many

NAMES = ("run", "plan", "budget", "online", "compare", "bound", "sweep")
FUNCTIONS = [getattr(pfdist, name) for name in NAMES if hasattr(pfdist, name)]


@pytest.mark.parametrize("function", FUNCTIONS)
def test_the_signature_shows_every_option_by_name(function: Callable[..., Any]) -> None:
    parameters = inspect.signature(function).parameters
    assert set(Options.__annotations__) <= set(parameters)
    kinds = {parameters[name].kind for name in Options.__annotations__}
    assert kinds == {inspect.Parameter.KEYWORD_ONLY}


@pytest.mark.parametrize("function", FUNCTIONS)
def test_an_unknown_option_is_refused_with_the_nearest(function: Callable[..., Any]) -> None:
    with pytest.raises(ArgumentError, match="got worker; did you mean 'workers'") as refused:
        function("job.toml", worker=2)
    assert "\n" not in str(refused.value)
    can_change = "changes" in inspect.signature(function).parameters
    assert ("changes=['KEY=VALUE'] changes a key of the job" in str(refused.value)) == can_change


WALK = pfdist.Problem("random_walk", horizon=12, measurement_budget=4, engine="kalman")
AS_LISTS: dict[str, Callable[[], bool]] = {
    "also": lambda: (
        names_argument("also", ["information", "quantile 0.9"])
        == names_argument("also", 'information,"quantile 0.9"')
    ),
    "columns": lambda: (
        columns_argument(["t=Time", "y0 = a=b"])
        == columns_argument("t=Time,y0=a=b")
        == columns_argument({"t": "Time", "y0": "a=b"})
    ),
    "times": lambda: sets_argument(["a=0,6", "regular"]) == {"a": "0,6", "regular": "regular"},
    "against": lambda: (
        of_as_many(as_job(WALK), ["0,6"])
        == of_as_many(as_job(WALK), "last=0,6")
        == of_as_many(as_job(WALK), {"last": [0, 6]})
    ),
    "over": lambda: (
        read_sweep(WALK, ["seed=1:3"], (), (), {}).points
        == read_sweep(WALK, {"seed": [1, 2, 3]}, (), (), {}).points
    ),
    "changes": lambda: as_job(WALK, ["seed=3"]).seed == 3,
    "reuse": lambda: paths_argument("reuse", ["a"]) == paths_argument("reuse", "a"),
}
LISTS = {"also", "columns", "reuse"} | {
    name for name, word in WORDS.items() if isinstance(word, Word) and word.settings.n_tokens == -1
}


def test_every_option_that_is_a_list_on_the_command_line_takes_a_list_in_python() -> None:
    assert LISTS - {"evaluate.times"} <= AS_LISTS.keys()
    for name, agrees in AS_LISTS.items():
        assert agrees(), name


def test_questions_take_lists_of_criteria_sets_and_columns(tmp_path: Any) -> None:
    """As the command line and mappings: the same answers."""
    draws = {"draws": 20}
    listed = pfdist.evaluate(WALK, ["a=0,6", "b=3,9"], **draws, also=["information"])
    named = pfdist.evaluate(WALK, {"a": [0, 6], "b": "3,9"}, **draws, also="information")
    assert {name: each.expected_mse for name, each in listed.items()} == {
        name: each.expected_mse for name, each in named.items()
    }
    assert listed["a"].also == named["a"].also != {}
    options = {"draws": 20, "figures": False, "pool": "serial", "also": ["worst_instant"]}
    run = pfdist.compare(WALK, times=["a=0,6", "b=3,9"], results=tmp_path / "both", **options)
    assert list(run.sets) == ["a", "b"]
    assert "worst_instant" in run.table("sets")
    for wrong in ([5], ["a"], 5, ["=3"]):
        with pytest.raises(JobError, match="times"):
            pfdist.compare(WALK, times=wrong, results=tmp_path / "none", **options)
        with pytest.raises(ArgumentError, match="columns must be"):
            columns_argument(wrong)


def test_the_section_of_the_only_sensor_beside_those_of_sensors_is_one_line() -> None:
    with pytest.raises(JobError, match=r"sensor must be left out with .*sensors, got both"):
        pfdist.Problem(
            "two_compartments", horizon=10, measurement_budget=2, sensor={"fails": 0.1},
            sensors={"immunoassay": {}, "chromatography": {}},
        )  # fmt: skip
