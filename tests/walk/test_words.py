"""Names and prose of package and tests follow the house rules; a failure names files and lines."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from pathlib import Path

from pfdist import plots

ROOT = Path(__file__).parents[2]
FILES = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("pfdist", "benchmarks", "tests")
    for path in (ROOT / folder).rglob("*.py")
)
VAGUE = {"its", "one", "of", "no", "by"}

JOB_KEY = re.compile(
    r"(?<![\w./])(problem|model|filter|evaluation|comparison|budget|search|execution)\.[a-z]\w+"
    r"|(?<![\w-])--[a-z]"
)
BACKWARD = re.compile(r"(?:\A|\n\s*\n|(?<=[.:?!])\s+|\n    )(?:Of|What|By(?! default))\s[^.]*")
SETS_OF_TIMES = "affordable constraints feasible spacing written"
BELOW_PROBLEM = re.compile("pfdist/(filters|kernels|store|pools|densities|common)/")
CALENDAR = {"clock", "calendar", "date", "dates", "timezone", "zoneinfo"}
OF_MODELS = {"CLOCK", "on_clock", "reads_clock", "DATES"}  # arrays of numbers that formulas read
OF_TABLES = {"_DATE", "dates"}  # the texts of a column for people
LOW_ROOMS = (
    *("pfdist/common/", "pfdist/models/", "pfdist/search/"),
    *(f"pfdist/problem/{module}.py" for module in SETS_OF_TIMES.split()),
)


parsed = cache(ast.parse)


TEXT = re.compile(r'(?s)("""|"|\'\'\'|\')(?:\\.|.)*?\1|#[^\n]*')


def code_of(source: str) -> str:
    """A module without its comments and texts, but for what f-strings format."""
    return TEXT.sub(lambda each: " ".join(re.findall(r"\{[^{}]*", each[0])), source)


def names(source: str) -> Iterator[tuple[int, str]]:
    """Every variable, argument, attribute, definition and imported name, with its line."""
    for node in ast.walk(parsed(source)):
        name = ""
        if isinstance(node, ast.Name):
            name = node.id
        elif isinstance(node, (ast.arg, ast.keyword)):
            name = node.arg or ""
        elif isinstance(node, ast.Attribute):
            name = node.attr
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef, ast.alias)):
            name = node.name
        if name:
            yield node.lineno, name


def vague_names(source: str) -> Iterator[str]:
    """Every vague name, and its line."""
    if VAGUE & {*re.findall(r"\w+", code_of(source))}:  # most files need not be parsed
        yield from (f"{line}: {name}" for line, name in names(source) if name in VAGUE)


def calendar_names(source: str) -> Iterator[str]:
    """Every name with a word of clocks, dates or units of time, and its line."""
    for line, name in names(source):
        parts = re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower())
        if CALENDAR & {*parts} and name not in OF_MODELS | OF_TABLES:
            yield f"{line}: {name}"


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Every docstring and every block of comments, with its first line."""
    for node in ast.walk(parsed(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            doc = ast.get_docstring(node)
            if doc:
                yield getattr(node, "lineno", 1), doc
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string.lstrip("# ")


def messages(source: str) -> Iterator[tuple[int, str]]:
    """Every string that is no docstring, with its line."""
    tree = parsed(source)
    docs = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
            yield node.lineno, node.value


def found_in(files: Iterable[str], check: Callable[[str], Iterator[str]]) -> str:
    """All that a check finds in these files, each with its file and line."""
    return "\n".join(
        f"{file}:{line}" for file in files for line in check((ROOT / file).read_text())
    )


def backward_sentences(source: str) -> Iterator[str]:
    if not re.search(r"\b(Of|What|By)\s", source):
        return  # most files need not be parsed
    for line, text in prose(source):
        for match in BACKWARD.finditer(text):
            yield f"{line}: {match[0].strip()[:60]}"


def keys_in_messages(source: str) -> Iterator[str]:
    for line, text in messages(source):
        if match := JOB_KEY.search(text):
            yield f"{line}: {match[0]}"


# A formula of a model, a function of an engine, a figure and a command have names of their kinds.
OF_A_KIND = ("pfdist/models/library/", "pfdist/cli/own.py")
COMMAND = "command.py"  # of a plugin: it has the name of the function of the library
ENGINES_HAVE = {"filter_checked_draws", "filter_checked_sets", "log_evidence", "simulate"}


def public_names(source: str) -> Iterator[str]:
    """Each public class and function of a module, by name; variants for a type checker once."""
    yield from {*re.findall(r"(?m)^(?:class|def) ([^\W_]\w*)", source)} - ENGINES_HAVE


def test_a_name_means_the_same_in_the_whole_package() -> None:
    places = defaultdict[str, list[str]](list)
    for file in FILES:
        if (
            file.startswith("pfdist/")
            and not file.startswith(OF_A_KIND)
            and not file.endswith(COMMAND)
        ):
            for name in public_names((ROOT / file).read_text()):
                is_figure = name in plots.__all__ and "matplotlib" in (ROOT / file).read_text()
                places[name] += [] if is_figure else [file]
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_variables_have_nouns_for_names() -> None:
    assert found_in(FILES, vague_names) == ""


def test_no_sentence_begins_with_of_what_or_by() -> None:
    assert found_in(FILES, backward_sentences) == ""


def test_low_floors_name_no_job_key_and_no_option_in_messages() -> None:
    low = [file for file in FILES if file.startswith(LOW_ROOMS)]
    assert found_in(low, keys_in_messages) == ""


def test_rooms_below_problem_know_no_clock_and_no_calendar() -> None:
    assert found_in(filter(BELOW_PROBLEM.match, FILES), calendar_names) == ""


def test_the_checks_find_what_they_look_for() -> None:
    found = sorted(vague_names("def f(its):\n    return [one.by for one in its]"))
    assert found == ["1: its", "2: by", "2: its", "2: one", "2: one"]
    assert BACKWARD.search("A set.\n\nOf equal sets the first is given.")
    assert not BACKWARD.search("The first of equal sets. By default all sets.")
    assert JOB_KEY.search("problem.forbidden must lie")
    assert JOB_KEY.search("give --draws")
    assert not JOB_KEY.search("pfdist.models.library.ungm --")
    assert [*calendar_names("clock_of(x.on_clock, ZoneDate)")] == ["1: clock_of", "1: ZoneDate"]
