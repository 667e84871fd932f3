"""No control character of a model, a job or a run reaches a terminal, a page or a figure."""

import io
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

import pfdist
from pfdist.cli.main import main
from pfdist.common.parts import Cell, Code, Facts, Page, Section, Table, Text
from pfdist.common.shown import as_fragment
from pfdist.errors import PfdistError, PfdistWarning
from pfdist.pages.figure import Plot, drawn
from pfdist.pages.html import as_html
from pfdist.pages.terminal import lines_of
from pfdist.questions.display import Display
from pfdist.runner.progress import Progress

BAD = "a\x1b[2J\x07\x9b\u202e\x00b"
GOOD = "a?[2J????b"


def _is_clean(text: str) -> bool:
    return all(line.isprintable() for line in text.replace("\xa0", " ").split("\n"))


@pytest.mark.parametrize("show", [as_html, as_fragment, lambda page: "\n".join(lines_of(page))])
def test_every_part_of_a_page_is_clean(show: Callable[[Page], str]) -> None:
    blocks = [
        Text(BAD),
        Code(f"first {BAD}\nsecond", detail=False),
        Facts([(BAD, BAD)], BAD),
        Table(BAD, [BAD, "other"], [[Cell(BAD), Cell(BAD)]]),
    ]
    text = show(Page(BAD, BAD, [Section(BAD, blocks)], [BAD], source=BAD))
    assert _is_clean(text)
    assert GOOD in text


def test_a_number_stays_beside_its_unit_but_code_is_copied_as_it_is() -> None:
    text = "At t = 3 h, 10.0 ± 0.5 % of 8,000 draws."
    html = as_html(Page("", "", [Section("", [Text(text), Code(text)])]))
    glued = "At t\xa0=\xa03\xa0h, 10.0\xa0±\xa00.5\xa0% of 8,000\xa0draws."
    assert f"<p>{glued}</p>" in html
    assert f">{text}</pre>" in html


def test_code_is_marked_and_dates_and_short_words_stay_on_a_line() -> None:
    text = "On 2026-03-02, `pfdist run a = <b>` needs an x-ray. It is in runs/a-b."
    page = Page("", "", [Section("", [Text(text)])])
    code = "<code>pfdist run a = &lt;b&gt;</code>"
    date, word = (
        f'<span style="white-space: nowrap">{each}</span>' for each in ("2026-03-02", "x-ray")
    )
    assert f"<p>On {date}, {code} needs an {word}. It is in runs/a-b.</p>" in as_html(page)
    assert code in as_fragment(page)


def test_the_texts_of_a_figure_are_clean() -> None:
    def draw(panels: Any) -> None:
        panels[0].plot([0, 1], [0, 1], label=BAD)
        panels[0].legend(title=BAD)
        panels[0].set_xlabel(f"two\nlines {BAD}")
        panels[0].set_xticks([0, 1], [BAD, "1"])

    file = io.StringIO()
    drawn(Plot(2.0, draw)).savefig(file, format="svg")
    assert _is_clean(file.getvalue())
    assert GOOD in file.getvalue()


def test_errors_warnings_and_progress_are_clean() -> None:
    assert str(PfdistError(BAD)) == str(PfdistWarning(BAD)) == GOOD
    out = io.StringIO()
    with Display(Console(file=out, width=80)) as display:
        display.show(Progress(BAD, 1.0, 1.0))
        display.say(BAD)
    assert _is_clean(out.getvalue())
    assert out.getvalue().count(GOOD) == 2


@pytest.mark.slow
def test_a_model_with_such_a_name_has_clean_answers(
    small_job: pfdist.Job, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = "from dataclasses import replace\nfrom pfdist.models.library.ungm import model as ungm\n"
    (tmp_path / "a.py").write_text(f"{text}model = replace(ungm, name={BAD!r})\n")
    run = str(tmp_path / "run")
    assert (
        main(["run", str(small_job.path), "--results", run, "--set", "model.name=a.py:model"]) == 0
    )
    for words in (["status", run, "--verbose"], ["table", run], ["list", str(tmp_path)]):
        assert main(words) == 0
        assert main([*words, "--json"]) == 0
    printed = capsys.readouterr()
    files = [file for file in Path(run).rglob("*") if file.suffix in (".html", ".svg")]
    for shown in (printed.out, printed.err, *(file.read_text() for file in files)):
        assert _is_clean(shown)
