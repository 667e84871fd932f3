"""The two styles: their fonts, colours that all readers tell apart, and settings of the machine."""

import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import font_manager, style
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.ft2font import FT2Font

from oracles.in_turn import in_turn
from pfdist.pages.style import COLUMN_INCHES, PALETTE, PRINT, SCREEN, SERIES, set_style, styled

ROOT = Path(__file__).parents[2]
# The variables of a report: of light, dark and printed pages.
PAGES = [
    dict(re.findall(r"--(\w+): (#\w+);", part))
    for part in (ROOT / "pfdist/pages/style.css").read_text().split(":root {")[1:]
]
LIGHT, DARK = ({name: pair[k] for name, pair in PALETTE.items()} for k in range(2))
# Machado, Oliveira and Fernandes, "A physiologically-based model for simulation of color vision
# deficiency", IEEE Transactions on Visualization and Computer Graphics 15, 2009: table 1, severity
# 1.0, on linear RGB.
VISION = {
    "all cones": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
# IEC 61966-2-1: from linear sRGB to XYZ, over the white point D65.
XYZ = np.array(
    [[0.412456, 0.357576, 0.180437], [0.212673, 0.715152, 0.072175], [0.019334, 0.119192, 0.950304]]
) / [[0.95047], [1.0], [1.08883]]

both = pytest.mark.parametrize("name", [PRINT, SCREEN])


def _linear(colour: str) -> np.ndarray:
    value = np.array(to_rgb(colour))
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


def _lab(linear: np.ndarray) -> np.ndarray:
    """CIELAB, 1976."""
    relative = XYZ @ np.clip(linear, 0, 1)
    f = np.where(relative > 216 / 24389, np.cbrt(relative), (24389 / 27 * relative + 16) / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_print_report_and_site_have_one_palette() -> None:
    for page, colours in zip(PAGES, (LIGHT, DARK, LIGHT), strict=True):
        assert {name: page[name] for name in colours} == colours
    logo = (ROOT / "docs/static/logo.svg").read_text()
    assert {*re.findall("#[0-9a-f]{6}", logo)} <= {*LIGHT.values(), *DARK.values()}


@in_turn("vision", VISION)
@in_turn("page", range(3))
def test_every_two_colours_are_apart_for_every_reader(page: int, vision: str) -> None:
    """Also from the text, whose colour the bound has: Delta E of CIE 1976."""
    colours = (LIGHT, DARK, LIGHT)[page] | {"ink": PAGES[page]["ink"]}
    seen = {name: _lab(VISION[vision] @ _linear(colour)) for name, colour in colours.items()}
    for first, second in itertools.combinations(seen, 2):  # 2.3 is a just noticeable difference
        assert np.linalg.norm(seen[first] - seen[second]) >= 24, (first, second)


def test_the_simulation_knows_colours_that_a_deuteranope_confuses() -> None:
    red, green = (
        _lab(VISION["deuteranopia"] @ _linear(colour)) for colour in ("#c86464", "#8c8c64")
    )
    assert np.linalg.norm(red - green) < 15


@pytest.mark.parametrize("page", range(3))
def test_every_colour_stands_out_from_its_paper(page: int) -> None:
    for ground, (name, colour) in itertools.product(
        ("paper", "card"), (LIGHT, DARK, LIGHT)[page].items()
    ):
        light = [float(XYZ[1] @ _linear(each)) + 0.05 for each in (colour, PAGES[page][ground])]
        assert max(light) / min(light) >= 3, name  # WCAG 2.2, 1.4.11


def test_sets_of_times_differ_without_colour() -> None:
    looks = [set_style(number) for number in range(5)]
    assert len({str((look["ls"], look["marker"], look["mfc"] == "white")) for look in looks}) == 5
    assert len({look["color"] for look in looks}) == 5


@both
def test_fonts_have_a_true_minus_sign_and_figures_use_it(name: str) -> None:
    with styled(name):
        assert mpl.rcParams["axes.unicode_minus"]
        family = mpl.rcParams["font.family"][0]
        first = mpl.rcParams[f"font.{family}"][0]
        file = font_manager.findfont(first, fallback_to_default=False)
        assert FT2Font(file).get_char_index(ord("\N{MINUS SIGN}"))
        axes = Figure(layout="constrained").subplots()
        axes.plot([-2, -1], [-20, -10])
        axes.figure.draw_without_rendering()
        texts = [label.get_text() for label in (*axes.get_xticklabels(), *axes.get_yticklabels())]
    assert any("\N{MINUS SIGN}" in text for text in texts)
    assert not any("-" in text for text in texts)


@both
def test_a_style_is_found_by_its_name_and_has_the_colours_of_the_figures(name: str) -> None:
    with style.context(name):
        assert [to_rgb(each["color"]) for each in mpl.rcParams["axes.prop_cycle"]] == [
            *map(to_rgb, SERIES)
        ]
        assert mpl.rcParams["figure.constrained_layout.use"]


def test_print_is_one_column_wide_in_8_points_and_embeds_its_fonts() -> None:
    with style.context(PRINT):
        assert mpl.rcParams["figure.figsize"][0] == COLUMN_INCHES
        assert mpl.rcParams["font.size"] == 8
        assert mpl.rcParams["pdf.fonttype"] == 42  # TrueType: text that can be searched


def _printed(code: str, settings: dict[str, str]) -> str:
    """Give the output of a process with these settings, which says nothing else."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | settings, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.strip()


@pytest.mark.slow
def test_figures_that_are_saved_need_no_pyplot() -> None:
    code = (
        "import sys, pfdist.pages.figure; from pfdist.pages.style import styled\n"
        "with styled(): pass\n"
        "print('matplotlib.pyplot' in sys.modules)"
    )
    assert _printed(code, {}) == "False"


@pytest.mark.parametrize(
    "settings",
    [
        pytest.param({"MPLBACKEND": "TkAgg"}, marks=pytest.mark.slow),  # needs a screen
        pytest.param({"MPLBACKEND": "nonsense"}, marks=pytest.mark.slow),
        pytest.param({"HOME": "/proc", "MPLCONFIGDIR": ""}, marks=pytest.mark.slow),
        pytest.param({"MPLCONFIGDIR": "/proc/x"}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_no_setting_of_the_machine_ends_the_drawing_or_is_told(settings: dict[str, str]) -> None:
    """Neither a backend nor a folder for Matplotlib's settings that cannot be used."""
    backend = settings.get("MPLBACKEND", os.environ.get("MPLBACKEND", "None"))
    for first in ("pfdist.pages", "pfdist; pfdist.plan"):
        script = f"import os, {first}\nprint(os.environ.get('MPLBACKEND'))"
        assert _printed(script, settings) == backend


def test_figures_do_not_depend_on_settings_of_matplotlib() -> None:
    with mpl.rc_context({"text.usetex": True, "axes.grid": True}), styled():
        assert (mpl.rcParams["text.usetex"], mpl.rcParams["axes.grid"]) == (False, False)
