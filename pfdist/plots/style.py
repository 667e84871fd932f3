"""Colours and settings of all figures: one column wide, readable in print and without colour."""

from typing import Any

BLUE, RED, ORANGE, GREEN, GREY = "#1f5fa8", "#c8261d", "#d98a00", "#2f7d4f", "#6f6f6f"
SERIES = (RED, BLUE, ORANGE, GREEN)

COLUMN_INCHES = 3.5

STYLE: Any = {
    "font.family": "serif",
    "font.serif": ["STIXGeneral", "DejaVu Serif"],
    "mathtext.fontset": "stix",
    "font.size": 8.5,
    "axes.titlesize": 8.5,
    "legend.fontsize": 7,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "lines.linewidth": 1.1,
    "legend.frameon": False,
    "savefig.dpi": 300,
    "svg.hashsalt": "pfdist",  # the same figure gives the same file
}
