"""The words that zsh offers for a command line when a person presses Tab in a terminal."""

import os
import pty
import select
import subprocess
import time
from pathlib import Path

_SECONDS = 60  # for one answer
_ASK = r"""
PROMPT= RPROMPT=
setopt extendedglob
fpath=($PWD/functions $fpath)
autoload -U compinit
compinit -u -d $PWD/dump
bindkey '^I' complete-word
comppostfuncs=(finish)
finish() { print END >> $ANSWER; exit }
compadd() {
  # With -O, -A or -D nothing is offered.
  if [[ " ${@[1,(i)(-|--)]} " == *\ -[a-zA-Z]#[OAD]\ * ]]; then builtin compadd "$@"; return; fi
  local -a found
  builtin compadd -A found "$@"
  (( $#found )) && print -rl -- $found >> $ANSWER
  builtin compadd "$@"
}
print ready
"""


def completed_by_zsh(line: str, folder: Path) -> set[str]:
    """Give the words that zsh offers for the last word of a command line.

    Parameters
    ----------
    line : str
    folder : Path
        Where zsh runs. It holds the completion script as ``functions/_cyclopts_pfdist``.
    """
    answer = folder / "answer"
    answer.write_text("")
    (folder / "ask").write_text(_ASK)
    terminal, other_end = pty.openpty()
    environment = {**os.environ, "ANSWER": str(answer), "TERM": "dumb"}
    with subprocess.Popen(
        ["zsh", "-f", "-i"], cwd=folder, env=environment, start_new_session=True,
        stdin=other_end, stdout=other_end, stderr=other_end,
    ) as shell:  # fmt: skip
        os.close(other_end)
        try:
            os.write(terminal, b". ./ask\n")
            _read(terminal, shell, b"ready\r\n")
            os.write(terminal, line.encode() + b"\t")
            _read(terminal, shell, b"never")
        finally:
            shell.kill()
            os.close(terminal)
    offered = answer.read_text().split("\n")
    assert "END" in offered
    return set(offered) - {"END", ""}


def _read(terminal: int, shell: subprocess.Popen[bytes], until: bytes) -> None:
    """Read the output of zsh until it has printed some bytes, or has ended."""
    end, seen = time.monotonic() + _SECONDS, b""
    while until not in seen and shell.poll() is None and time.monotonic() < end:
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                seen += os.read(terminal, 4096)
            except OSError:  # zsh has ended
                return
