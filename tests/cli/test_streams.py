"""Standard streams that are closed or full change nothing but what is seen."""

import os
import subprocess
import sys

import pytest

SAYS = """
import os, sys
from pfdist.cli.streams import flush_output, make_harmless
make_harmless()
first = os.open(os.devnull, os.O_RDONLY)
print("display" * 10_000, file=sys.stderr)
sys.stderr.flush()
try:
    print("answer")
    flush_output()
    code = 0
except OSError as error:
    code = 3 + ("standard output cannot be written" in str(error))
sys.exit(code if first > 2 else 9)
"""


@pytest.mark.parametrize(
    ("redirections", "code"),
    [
        pytest.param("2>&-", 0, id="stderr-closed"),
        pytest.param("2>/dev/full", 0, id="stderr-full"),
        pytest.param(">&-", 0, id="stdout-closed"),
        pytest.param(">&- 2>&-", 0, id="both-closed"),
        pytest.param("<&- >&- 2>&-", 0, id="all-closed"),
        pytest.param(">/dev/full", 4, id="stdout-full"),
        pytest.param(">/dev/full 2>/dev/full", 4, id="both-full"),
    ],
)
def test_only_an_answer_that_cannot_be_written_is_an_error(redirections: str, code: int) -> None:
    command = ["sh", "-c", f'"$0" -c "$1" {redirections}', sys.executable, SAYS]
    buffered = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    done = subprocess.run(command, capture_output=True, text=True, env=buffered, check=False)
    assert done.returncode == code
    assert "Exception" not in done.stderr + done.stdout
    assert "display" not in done.stdout  # what is meant for standard error goes nowhere else
