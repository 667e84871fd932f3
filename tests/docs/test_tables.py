"""The manual's tables of what a job can name are those made from the declarations."""

import importlib.util
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import pandas as pd
import pyarrow.parquet as pq
import pytest

from oracles.in_turn import in_turn
from pfdist.cli.commands import COMMANDS
from pfdist.densities import DENSITIES
from pfdist.filters.engines import ENGINES
from pfdist.kernels.schemes import SCHEMES
from pfdist.pages.figure import FIGURES
from pfdist.problem.methods import METHODS
from pfdist.store.schema import KEYS

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.glob("*.md"))


def _script(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(f"docs_{name}", DOCS / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    return _script("tables")


@pytest.mark.plugins("backtest", "budget", "check", "explorer", "filter", "online", "why")
def test_pictures_were_drawn_by_the_code_of_today(monkeypatch: pytest.MonkeyPatch) -> None:
    """A number of the code alters its hash; a comment and a docstring do not."""
    pictures = _script("pictures")
    assert pictures.stale() == [], "run `python docs/pictures.py`, and look at what it made"
    code = {'"""A line."""\nx = 1\n': 0, "x = 1  # one\n": 0, "x = 2\n": 1}
    hashes = list[str]()
    for text in code:
        monkeypatch.setattr(Path, "read_text", lambda *_, text=text, **__: text)
        hashes.append(pictures.code_of("blood"))
    assert hashes[0] == hashes[1] != hashes[2]


@in_turn("page", [*PAGES, DOCS.parent / "README.md"])
def test_a_page_has_the_tables_that_the_declarations_make(page: Path, tables: ModuleType) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == tables.with_tables(text), "run `python docs/tables.py`"


def test_stubs_have_the_names_of_plugins(tables: ModuleType) -> None:
    for stub, hook in tables.STUBS.items():
        text = stub.read_text(encoding="utf-8")
        assert text == tables.with_names_of_plugins(stub, hook), "run `python docs/tables.py`"


def test_the_manual_has_every_table_once(tables: ModuleType) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert sorted(re.findall(r"<!-- table: (\w+) -->", text)) == sorted(tables.TABLES)


def test_a_table_names_everything_that_is_declared(tables: ModuleType) -> None:
    for table, declared in (
        ("figures", [name for name, figure in FIGURES.items() if not figure.each_set]),
        ("methods", tables.LISTED),
        ("engines", ENGINES),
        ("schemes", SCHEMES),
        ("densities", DENSITIES),
    ):
        assert [name for name in declared if f"| `{name}`" not in tables.TABLES[table]()] == []


def test_settings_have_the_defaults_and_the_bounds_that_a_job_is_held_to(
    tables: ModuleType,
) -> None:
    rows = tables.settings().splitlines()
    assert any(
        row.startswith("| `genetic` | `population` | 50 | at least 2, even |") for row in rows
    )
    offered = tables.LISTED.items()
    keys = [(name, key) for name, method in offered for key in method.section().settings]
    assert [re.findall(r"`(\w+)`", row)[:2] for row in rows[2:]] == [list(pair) for pair in keys]
    assert not [row for row in rows if "|  |" in row]  # every setting has bounds and a meaning


def test_an_old_table_is_replaced(tables: ModuleType) -> None:
    page = "before\n<!-- table: engines -->\n| old |\n<!-- end -->\nafter\n"
    made = tables.with_tables(page)
    assert "old" not in made
    assert made.startswith("before\n<!-- table: engines -->\n| engine |")
    assert made.endswith("|\n<!-- end -->\nafter\n")


def test_the_reference_has_every_key_of_a_job_with_its_meaning(tables: ModuleType) -> None:
    rows = [row.split(" | ") for row in tables.keys().splitlines() if row.startswith("| `")]
    assert all(len(row) == 4 and row[1] and row[3].strip(" |") for row in rows)
    keys = {row[0].strip("| `") for row in rows}
    paper = tomllib.loads((DOCS.parent / "jobs" / "paper.toml").read_text())
    settings = {key for method in METHODS.values() for key in method.section().settings}
    assert keys_of(paper) - settings <= keys | {"filter"}
    row = next(row for row in rows if row[0] == "| `particles`")
    assert row[1:3] == ["at least 1, at most 10,000,000 or `auto`", "500"]


def keys_of(section: dict[str, object]) -> set[str]:
    """All keys of a job file that have values, of sections in sections too."""
    keys = set[str]()
    for key, value in section.items():
        inner = value if isinstance(value, list) else [value]
        sections = [each for each in inner if isinstance(each, dict) and key != "parameters"]
        keys |= set().union(*map(keys_of, sections)) if sections else {key}
    return keys


def test_the_reference_has_every_table_column_and_option(tables: ModuleType) -> None:
    columns = tables.columns()
    assert all(f"## `{table}`" in columns for table in KEYS)
    for path in (DOCS.parent / "results" / "example" / "tables").glob("*/*.parquet"):
        for column in pq.read_schema(path):
            generic = re.sub("(evenly_spaced|relaxation|genetic)", "SET", column.name)
            generic = re.sub("_(state|measurement)", "_0", generic)  # the names of z and y
            row = rf"(?m)^\| .*`{generic}`.* \| .* \|$"
            assert re.search(row, columns), (path.name, column.name)
    usage = tables.usage()
    for name in COMMANDS:
        assert f"## {name}\n" in usage
        said = [words for words, text in tables.arguments_of(name) if tables._JOB.sub("", text)]
        assert all(f"| `{words}` |" in usage for words in said)


def test_a_measured_number_with_an_error_stands_in_a_made_table_or_in_what_a_command_prints() -> (
    None
):
    made = re.compile(r"(?ms)<!-- table: .*?<!-- end -->|^```.*?^```")
    number = re.compile(r"\d ± \d|\(95 % CI ")
    texts = {page.name: made.sub("", page.read_text(encoding="utf-8")) for page in PAGES}
    texts["README.md"] = made.sub("", (DOCS.parent / "README.md").read_text(encoding="utf-8"))
    assert not [name for name, text in texts.items() if number.search(text)]


def test_the_tables_of_benchmarks_lack_no_number() -> None:
    text = (DOCS.parent / "benchmarks" / "results" / "README.md").read_text(encoding="utf-8")
    assert re.findall(r"^.*\bnan\b.*$", text, re.MULTILINE) == []


def test_the_gallery_shows_nine_systems_that_can_be_loaded_quickly() -> None:
    table = pd.read_csv(DOCS / "gallery.csv")
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    assert len(table) == 9
    for name in table["job"]:
        assert (DOCS.parent / "jobs" / f"{name}.toml").is_file()
        assert (DOCS / "figures" / f"gallery-{name}.png").stat().st_size < 100_000
        assert f"(figures/gallery-{name}.png)" in page
