"""Keys, options, commands and arguments that earlier versions had, and what replaces each.

Whoever takes something back adds a line to `GONE`. A word that pfdist does not know is looked up
there first: a key of a job or a sweep file (`common.section`), an option or a command
(`cli.program`), an argument in Python (`questions.options`), and the ending of a table's file.
"""

GONE = {
    "judge": "scenarios find robust plans, see docs/robust.md",
    "doctor": "the line of an error says what a machine lacks, see docs/install.md",
    ".tex": "pandas writes LaTeX, as pfdist.table(RUN).to_latex()",
}
"""The replacement of each word. A key has its last parts, as many as identify it."""


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
