"""The plugins that ship: a folder each, with all that a capability needs; and their list.

CONTRIBUTING.md says how to add one, and how to delete one.
"""

PLUGINS = (
    "accelerator",
    "backtest",
    "budget",
    "check",
    "explorer",
    "filter",
    "fit",
    "guided",
    "init",
    "moving",
    "online",
    "rule",
    "runs",
    "simulate",
    "sweep",
    "why",
)
