"""Keys, options, commands and arguments that earlier versions had, and what replaces each.

Whoever takes something back adds a line to `GONE`. A word that pfdist does not know is looked up
there first: a key of a job or a sweep file (`common.section`), an option or a command
(`cli.program`), an argument in Python (`questions.options`), and the ending of a table's file.
"""

from typing import Any

from pfdist.errors import shown

GONE = {
    "judge": "scenarios find robust plans, see docs/robust.md",
    "doctor": "the line of an error says what a machine lacks, see docs/install.md",
    ".tex": "pandas writes LaTeX, as pfdist.table(RUN).to_latex()",
    "dtype": "all states are float64",
    "parallel": "each point of a sweep with values that belong together is a [[point]]",
    "wait_for_cores": "a run begins with the cores there are, and uses those of nodes that join",
    "until": "where intervals are too wide, the same run goes on with more draws",
    "estimator": "each search estimates errors as docs/searches.md says",
}
"""The replacement of each word. A key has its last parts, as many as identify it."""
_FORMER_DEFAULTS = {
    "estimator": ("squared_error", "auto"),
    "dtype": ("float64",),
    "until": ({"half_width": 0.0},),
}
"""Values of keys that are gone with which a job means what it means without the key."""


def gone(word: str) -> str:
    """The error about a word that earlier versions had; empty for any other word.

    >>> gone("--judge")
    '--judge is gone: scenarios find robust plans, see docs/robust.md'
    >>> gone("--jugde")
    ''
    """
    name = word.removeprefix("--").replace("-", "_")
    instead = (text for key, text in GONE.items() if name == key or name.endswith(f".{key}"))
    return next((f"{word} is gone: {text}" for text in instead), "")


def without_gone(section: Any, place: str = "") -> tuple[Any, list[str]]:
    """A section of a recorded job without keys that are gone, and those that meant something.

    >>> without_gone({"draws": 30, "estimator": "auto"})
    ({'draws': 30}, [])
    >>> without_gone({"search": [{"estimator": "two_filters"}]})
    ({'search': [{}]}, ["search.estimator = 'two_filters'"])
    """
    if isinstance(section, list):
        parts = [without_gone(each, place) for each in section]
        return [kept for kept, _ in parts], [name for _, names in parts for name in names]
    if not isinstance(section, dict):
        return section, []
    kept, ignored = {}, list[str]()
    for key, value in section.items():
        name = f"{place}.{key}".removeprefix(".")
        if gone(name):
            is_default = value in _FORMER_DEFAULTS.get(key, ())
            ignored += [] if is_default else [f"{name} = {shown(value)}"]
        else:
            kept[key], names = without_gone(value, name)
            ignored += names
    return kept, ignored
