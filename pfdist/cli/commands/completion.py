"""The command ``pfdist completion``, and the script by which a shell completes command lines.

shtab makes the script from the parser. The shell completes a word without starting Python.
"""

from argparse import Namespace
from typing import Any

import shtab

from pfdist.cli.arguments import argument
from pfdist.cli.command import command
from pfdist.cli.parser import complete_parser, subparsers_of

_SHELLS = ("bash", "zsh", "fish")


@command(
    "completion",
    argument("shell", metavar="SHELL", choices=_SHELLS, help=f"your shell: {', '.join(_SHELLS)}"),
    examples={
        'eval "$(pfdist completion bash)"': "Complete by Tab in this terminal",
        "pfdist completion bash > ~/.pfdist.bash": (
            "Keep the script, for the line `. ~/.pfdist.bash` in ~/.bashrc"
        ),
        "pfdist completion zsh > ~/.zfunc/_pfdist": (
            "Keep it for zsh, with `fpath+=~/.zfunc` before compinit in ~/.zshrc"
        ),
        "pfdist completion fish > ~/.config/fish/completions/pfdist.fish": (
            "Complete in every terminal of fish"
        ),
    },
)
def completion_command(options: Namespace) -> None:
    """Print a script by which a shell completes commands, options, jobs and runs."""
    print(script(options.shell))


# In bash, only folders that hold a run, and folders at most two levels above such a folder.
_RUNS_IN_BASH = """
_pfdist_run_dirs() {
  local folder
  compgen -d -- "$1" | while IFS= read -r folder; do
    if compgen -G "$folder/run.json" || compgen -G "$folder/*/run.json" ||
      compgen -G "$folder/*/*/run.json"
    then printf '%s\\n' "$folder" >&3
    fi
  done 3>&1 >/dev/null
}
"""


def _files(*patterns: str) -> dict[str, Any]:
    """Completes names of files that match one of some patterns."""
    one_of = patterns[0] if len(patterns) == 1 else f"({'|'.join(patterns)})"
    # shtab writes (*.toml), which zsh does not take for a pattern.
    return {**shtab.glob(*patterns), "zsh": f"_files -g '{one_of}'"}


_RUN = {**shtab.DIRECTORY, "bash": "_pfdist_run_dirs", "preamble": {"bash": _RUNS_IN_BASH}}
_VALUES: dict[str, Any] = {
    "JOB": _files("*.toml"),
    "RUN": _RUN,
    "DIR": shtab.DIRECTORY,
    "NEW": shtab.DIRECTORY,
    "FILE": _files("*.parquet", "*.csv"),
    "TABLE": _files("*.csv", "*.parquet", "*.tex"),
    "MEASUREMENTS": _files("*.csv", "*.parquet"),
}
"""The files and folders that complete a value, by the word that stands for the value in help."""


def script(shell: str) -> str:
    """The completion script of a shell.

    Parameters
    ----------
    shell : str
        A shell that shtab knows, for instance bash.
    """
    from pfdist.models import installed_models

    parser = complete_parser()
    for added in subparsers_of(parser).values():
        action: Any  # shtab reads from its attributes which values an argument can have
        for action in added._actions:
            if action.metavar in _VALUES:
                action.complete = _VALUES[action.metavar]
            elif action.metavar == "MODEL":
                action.choices = sorted(installed_models())
            if shell == "zsh" and isinstance(action.metavar, str):
                # zsh takes what follows a bare colon for a command that completes the value.
                action.metavar = action.metavar.replace(":", r"\:")
    return shtab.complete(parser, shell)
