"""Pictures of fixed tables: `python tests/plots/test_images.py` draws the baselines anew.

The pictures are compared by `matplotlib.testing`. They hold everything but text, in axes that do
not move: other versions of FreeType set text wider or narrower, which would move whole curves. Text
and legends have tests of their own. The tolerance is a root mean square of grey levels. It allows
for the rounding of processors, which shades a curve's edge otherwise, and is half of what the
shortest missing curve changes.
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.testing.compare import compare_images
from matplotlib.text import Text

from pfdist.plots import (
    budget,
    error_profile,
    gain,
    one_draw,
    sampling_windows,
    worth,
)
from pfdist.plots.style import styled

BASELINE = Path(__file__).parent / "baseline"
DPI = 100
TOLERANCE = 1.0
T = np.arange(21)


def _profile() -> pd.DataFrame:
    parts = []
    for name, every, scale in (("regular", 5, 2.0), ("found", 4, 1.0)):
        error = scale * (1.2 + np.sin(T / 2) ** 2 + 0.6 * (T % every))
        parts.append(
            pd.DataFrame({"t": T, "measured": T % every == 0, "error": error, "name": name})
        )
    return pd.concat(parts).assign(standard_error=0.2)


def _worth() -> pd.DataFrame:
    rise = {"regular": [0.4, 2.0, 1.1, 0.2, 1.6], "found": [1.0, 1.4, 40.0, 0.9, 1.2]}
    parts = [
        pd.DataFrame({"name": name, "t": np.arange(0, 20, 4) + shift, "removed": values})
        for shift, (name, values) in enumerate(rise.items())
    ]
    return pd.concat(parts).assign(removed_error=0.1)


def _windows() -> pd.DataFrame:
    strict, wide = ["inside", "inside", "open", "outside"], ["inside", "inside", "inside", "open"]
    parts = []
    for t, step in ((2, 1), (7, -1), (12, 1), (19, -1)):
        instants = t + step * np.arange(4)
        parts.append(
            pd.DataFrame({"t": t, "moved_to": instants, "within_1": strict, "within_5": wide})
        )
    return pd.concat(parts, ignore_index=True)


def _budget() -> pd.DataFrame:
    numbers = np.arange(2, 16)
    parts = []
    for kind, scale in (("regular", 90.0), ("found", 60.0)):
        mse = scale / (numbers + 2) + 2.0 * (numbers % 3 == 0) * (kind == "regular")
        parts.append(pd.DataFrame({"kind": kind, "measurements": numbers, "expected_mse": mse}))
    table = pd.concat(parts, ignore_index=True).assign(bound=np.nan, bound_low=np.nan)
    table["low"], table["high"] = table["expected_mse"] - 0.5, table["expected_mse"] + 0.5
    found = table["kind"] == "found"
    table.loc[found, "bound"] = 0.93 * table["expected_mse"]
    table.loc[found, "bound_low"] = 0.88 * table["expected_mse"]
    return table.assign(draws=400, standard_error=0.25, measurement_times=[[]] * len(table))


def _comparison() -> pd.DataFrame:
    share = (np.arange(4000) + 0.5) / 4000
    ratio = np.concatenate([0.2 + 1.2 * share**2, [9.0] * 30])  # and a long tail
    other = np.concatenate([0.4 + 1.0 * share**1.5, [1.0] * 30])
    return pd.DataFrame({"mse_regular": 1.0, "mse_found": ratio, "mse_other": other})


def _trajectory() -> pd.DataFrame:
    z = 10 * np.sin(T / 3) + T % 3
    estimates = {"estimate_regular_0": 0.6 * z - 1, "estimate_found_0": 0.9 * z + 0.5}
    return pd.DataFrame({"t": T, "z_0": z, **estimates})


SETS = {"regular": [0, 5, 10, 15, 20], "found": [1, 4, 8, 9, 17]}
PICTURES: dict[str, Callable[[Axes], Axes]] = {
    "budget": lambda ax: budget(_budget(), target=8.0, ax=ax),
    "error_profile": lambda ax: error_profile(_profile(), draws=500, ax=ax),
    "gain": lambda ax: gain(_comparison(), "found", beside="other", ax=ax),
    "one_draw": lambda ax: one_draw(_trajectory(), SETS, title="draw 3", ax=ax),
    "sampling_windows": lambda ax: sampling_windows(_windows(), ax=ax),
    "worth": lambda ax: worth(_worth(), ax=ax),
}

every = pytest.mark.parametrize("name", PICTURES)


def _save(file: Path, name: str, change: Callable[[Axes], object] = lambda axes: None) -> Path:
    with styled():
        figure = Figure(figsize=(3.5, 2.2), layout="none")
        axes = PICTURES[name](figure.add_axes((0.05, 0.1, 0.9, 0.85)))
        change(axes)
        legend = axes.get_legend()
        for artist in (*figure.findobj(Text), *([legend] if legend else [])):
            artist.set_visible(False)
        figure.savefig(file, dpi=DPI, metadata={"Software": None})
    return file


def _difference(name: str, picture: Path) -> str | None:
    return compare_images(str(BASELINE / f"{name}.png"), str(picture), TOLERANCE)


@every
def test_it_looks_as_it_did(name: str, tmp_path: Path) -> None:
    told = _difference(name, _save(tmp_path / f"{name}.png", name))
    assert told is None, f"{told}: look at both; if it is meant, run this file"


@every
def test_a_picture_that_lacks_a_curve_or_has_other_limits_is_another(
    name: str, tmp_path: Path
) -> None:
    def without_the_last(axes: Axes) -> None:
        (*axes.get_lines(), *axes.patches)[-1].set_visible(False)

    def longer(axes: Axes) -> None:
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.05 * (high - low))

    for number, change in enumerate((without_the_last, longer)):
        assert _difference(name, _save(tmp_path / f"{number}.png", name, change)) is not None


if __name__ == "__main__":
    for known in PICTURES:
        _save(BASELINE / f"{known}.png", known)
