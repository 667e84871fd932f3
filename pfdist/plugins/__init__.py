"""The plugins that ship: a folder each, with all that a capability needs; and their list.

To remove a plugin, delete its folder here, its folder in ``tests/plugins``, its page of the manual
and its line below, and call ``python docs/tables.py``. To add one, see CONTRIBUTING.md.
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
