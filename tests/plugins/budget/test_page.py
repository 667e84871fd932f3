"""The page of a run with several numbers: its table, its sentences, its labels, its figure."""

from types import SimpleNamespace
from typing import Any, cast

import pandas as pd
import pytest

from pfdist.common.parts import Text
from pfdist.pages.terminal import lines_of_blocks
from pfdist.plugins.budget.page import budget_section
from pfdist.problem.set_key import labels_of_sets
from pfdist.results import columns

COLUMNS = 80
_NOTHING = dict.fromkeys(columns.COLUMNS)


class Budget:
    """A run of 16 measurements, as a chapter sees it."""

    is_compared = True
    notes = ()

    def __init__(self, scale: float = 1.0, reached: Any = None, **changes: Any) -> None:
        self.rows = {
            f"{kind}_16": SimpleNamespace(
                **_NOTHING
                | {
                    "name": f"{kind}_16",
                    "kind": kind,
                    "measurement_times": [*range(16)],
                    "measurements": 16,
                    "budget": 16,
                    "price": None,
                    "expected_mse": scale * mse,
                    "standard_error": scale * error,
                    "label": "plan of 16",
                    "particle_loss": 0.15,
                    "particle_loss_limit": 0.3,
                }
            )
            for kind, mse, error in (("regular", 34.207, 0.195), ("found", 25.846, 0.187))
        }
        vars(self.rows["found_16"]).update(changes)
        self.reference_row = self.rows["regular_16"]
        self.target = None if reached is None else 25.0
        nobody = {"measurements": None, "impossible": None}
        nobody |= {"interval": [None, None], "larger_that_do_not": [], "measurement_times": None}
        nobody |= {"with_more_particles": None}
        answers = {"found": nobody if reached is None else reached, "regular": nobody}
        self.reaching = lambda *target: answers
        if reached is not None and reached["measurements"]:
            self.rows["found_16"].budget = reached["measurements"]
        self.run = SimpleNamespace(tables=(), job={"filter": {"particles": 400}, "budget": {}})

    clock = SimpleNamespace(listed=str)
    distinct = property(lambda self: self.rows)
    sets = property(lambda self: pd.DataFrame([vars(row) for row in self.rows.values()]))

    def typical_errors(self, row: SimpleNamespace) -> str:
        return f"{row.budget} g/L"

    @property
    def lines(self) -> list[str]:
        return lines_of_blocks(budget_section(cast("Any", self)).blocks)


def test_the_table_of_a_budget_has_the_bound_and_the_limit_holds_as_it_is_printed() -> None:
    bound = {"bound": 25.4371, "bound_error": 0.145, "bound_low": 24.9399}
    _, _, *heads, row = Budget(**bound).lines[:6]
    words = "N regular plan as good, regular lower bound (95 % limit)"
    assert sorted(" ".join(heads).split()) == sorted(words.split())
    assert row == "16  34.21 ± 0.20  25.85 ± 0.19  more than 16  25.44 (24.93)"
    exact = Budget(bound=25.4371, bound_error=0.0, bound_low=25.4371).lines
    assert any(line.endswith("  25.437") for line in exact)
    wide = Budget(1e-20, **{key: 1e-20 * value for key, value in bound.items()}).lines
    assert "(2.585 ± 0.019)e-19  more than 16" in "\n".join(wide)
    assert max(map(len, wide)) <= COLUMNS + 1  # no cell of numbers is cut
    assert not any("bound" in line for line in Budget().lines)


FEW = "15 are provably too few; 16 is undecided"
REACH = "To reach an MSE of 25 you need"
AT = f": t = {[*range(16)]} (typical error {{}} g/L)"  # as `Budget` gives it


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({}, f"{REACH} 17 measurements (95 % CI 16 to 18){AT.format(17)}; {FEW}."),
        ({"impossible": None}, f"{REACH} 17 measurements (95 % CI 16 to 18){AT.format(17)}."),
        (
            {"measurements": 1, "interval": [1, 1], "impossible": None},
            f"{REACH} 1 measurement{AT.format(1)}.",
        ),
        (
            {"interval": [16, None], "larger_that_do_not": [19, 20]},
            f"{REACH} 17 measurements (95 % CI 16 to more){AT.format(17)}, "
            f"but 19, 20 do not reach it; {FEW}.",
        ),
        (
            {"measurements": None},
            f"None of these numbers of measurements reaches an MSE of 25; {FEW}.",
        ),
        (
            {"measurements": None, "with_more_particles": 16},
            "None of these numbers of measurements reaches an MSE of 25; with more particles 16 "
            "may be enough: these 400 lose at most 30.00 % of the expected MSE (95 % confidence; "
            f"estimate 15.00 %); {FEW}.",
        ),
    ],
)
def test_a_line_says_which_number_reaches_a_target_and_which_cannot(
    changes: dict[str, Any], told: str
) -> None:
    found = {"measurements": 17, "interval": [16, 18], "larger_that_do_not": []}
    found |= {"impossible": 15, "measurement_times": None, "with_more_particles": None} | changes
    blocks = budget_section(cast("Any", Budget(reached=found))).blocks
    texts = [block.text for block in blocks if isinstance(block, Text)]
    assert told in texts


def test_labels_of_sets_have_their_numbers_or_prices() -> None:
    job = {"search": [{"name": "genetic"}], "budget": {}}
    labels = {"evenly_spaced_05": "5 evenly spaced", "genetic_05": "plan of 5"}
    assert labels_of_sets(labels, job) == labels
    priced = job | {"problem": {"total_price": 500}}
    assert labels_of_sets(["genetic_300"], priced) == {"genetic_300": "plan for 300"}
