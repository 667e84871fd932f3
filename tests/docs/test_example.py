"""Every command of the worked example prints what the page shows."""

import re
import shlex
from doctest import ELLIPSIS, OutputChecker
from pathlib import Path

import pytest

from pfdist.cli.main import main

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "example.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w+)\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


@pytest.mark.slow
def test_the_example_prints_what_the_page_shows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    commands = 0
    for language, text in BLOCKS:
        first, _, rest = text.partition("\n")
        if first.startswith("# "):  # a file of this name
            Path(first.removeprefix("# ")).write_text(rest, encoding="utf-8")
        elif language == "console":
            assert main(shlex.split(first.removeprefix("$ pfdist "))) == 0
            printed = capsys.readouterr().out
            if not OutputChecker().check_output(rest, printed, ELLIPSIS):
                pytest.fail(f"{first}\nprints\n{printed}\nand not\n{rest}")
            commands += 1
        else:
            exec(compile(text, "example.md", "exec"), {})
    assert commands == 4
    assert Path("lake.filtered.png").stat().st_size > 10_000
