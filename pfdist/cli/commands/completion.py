"""The command ``pfdist completion``."""

from argparse import ArgumentParser, Namespace

from pfdist.cli.command import command

_SHELLS = ("bash", "zsh", "fish")


def _add_shell(parser: ArgumentParser) -> None:
    parser.add_argument(
        "shell", metavar="SHELL", choices=_SHELLS, help=f"your shell: {', '.join(_SHELLS)}"
    )


@command(
    "completion",
    _add_shell,
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
    from pfdist.cli.completion import script

    print(script(options.shell))
