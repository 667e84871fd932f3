"""The manual's tables of what a job can name are those made from the declarations."""

import importlib.util
import re
from pathlib import Path
from types import ModuleType

import pytest

from pfdist.densities import DENSITIES
from pfdist.filters.engines import ENGINES
from pfdist.kernels.estimators import ESTIMATORS
from pfdist.kernels.schemes import SCHEMES
from pfdist.plots.figure import FIGURES
from pfdist.pools.kinds import POOLS
from pfdist.search.methods import METHODS

DOCS = Path(__file__).parents[2] / "docs"
PAGES = sorted(DOCS.glob("*.md"))


@pytest.fixture(scope="module")
def tables() -> ModuleType:
    spec = importlib.util.spec_from_file_location("docs_tables", DOCS / "tables.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_page_has_the_tables_that_the_declarations_make(page: Path, tables: ModuleType) -> None:
    text = page.read_text(encoding="utf-8")
    assert text == tables.with_tables(text), "run `python docs/tables.py`"


def test_the_manual_has_every_table_once(tables: ModuleType) -> None:
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    assert sorted(re.findall(r"<!-- table: (\w+) -->", text)) == sorted(tables.TABLES)


def test_a_table_names_everything_that_is_declared(tables: ModuleType) -> None:
    for table, declared in (
        ("figures", [name for name, figure in FIGURES.items() if not figure.each_set]),
        ("methods", METHODS),
        ("pools", POOLS),
        ("engines", ENGINES),
        ("estimators", ESTIMATORS),
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
    keys = [(name, key) for name, method in METHODS.items() for key in method.section().settings]
    assert [re.findall(r"`(\w+)`", row)[:2] for row in rows[2:]] == [list(pair) for pair in keys]
    assert not [row for row in rows if "|  |" in row]  # every setting has bounds and a meaning


def test_an_old_table_is_replaced(tables: ModuleType) -> None:
    page = "before\n<!-- table: engines -->\n| old |\n<!-- end -->\nafter\n"
    made = tables.with_tables(page)
    assert "old" not in made
    assert made.startswith("before\n<!-- table: engines -->\n| engine |")
    assert made.endswith("|\n<!-- end -->\nafter\n")
