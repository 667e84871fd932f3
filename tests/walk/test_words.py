"""Names and prose of package and tests follow the house rules; a failure names files and lines."""

import ast
import io
import re
import tokenize
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

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
LOW_ROOMS = (
    *("pfdist/common/", "pfdist/models/", "pfdist/search/"),
    *(f"pfdist/problem/{module}.py" for module in SETS_OF_TIMES.split()),
)


def vague_names(source: str) -> Iterator[str]:
    """Every variable, argument, attribute and definition with a vague name, and its line."""
    for node in ast.walk(ast.parse(source)):
        name = ""
        if isinstance(node, ast.Name):
            name = node.id
        elif isinstance(node, (ast.arg, ast.keyword)):
            name = node.arg or ""
        elif isinstance(node, ast.Attribute):
            name = node.attr
        elif isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            name = node.name
        if name in VAGUE:
            yield f"{node.lineno}: {name}"


def prose(source: str) -> Iterator[tuple[int, str]]:
    """Every docstring and every block of comments, with its first line."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef)):
            doc = ast.get_docstring(node)
            if doc:
                yield getattr(node, "lineno", 1), doc
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield token.start[0], token.string.lstrip("# ")


def messages(source: str) -> Iterator[tuple[int, str]]:
    """Every string that is no docstring, with its line."""
    tree = ast.parse(source)
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
PLOTS = (ROOT / "pfdist/pages/plots.py").read_text()
ENGINES_HAVE = {"filter_checked_draws", "log_evidence", "simulate"}


def public_names(source: str) -> Iterator[str]:
    """Each public class and function of a module, by name; variants for a type checker once."""
    body = ast.parse(source).body
    kinds = (ast.ClassDef, ast.FunctionDef)
    names = {node.name for node in body if isinstance(node, kinds)}
    yield from (name for name in names - ENGINES_HAVE if not name.startswith("_"))


def test_a_name_means_the_same_in_the_whole_package() -> None:
    places = defaultdict[str, list[str]](list)
    for file in FILES:
        if file.startswith("pfdist/") and not file.startswith(OF_A_KIND):
            for name in public_names((ROOT / file).read_text()):
                is_figure = file.startswith("pfdist/pages/") and f'"{name}"' in PLOTS
                places[name] += [] if is_figure else [file]
    assert {name: files for name, files in places.items() if len(files) > 1} == {}


def test_variables_have_nouns_for_names() -> None:
    assert found_in(FILES, vague_names) == ""


def test_no_sentence_begins_with_of_what_or_by() -> None:
    assert found_in(FILES, backward_sentences) == ""


def test_low_floors_name_no_job_key_and_no_option_in_messages() -> None:
    low = [file for file in FILES if file.startswith(LOW_ROOMS)]
    assert found_in(low, keys_in_messages) == ""


def test_the_checks_find_what_they_look_for() -> None:
    found = sorted(vague_names("def f(its):\n    return [one.by for one in its]"))
    assert found == ["1: its", "2: by", "2: its", "2: one", "2: one"]
    assert BACKWARD.search("A set.\n\nOf equal sets the first is given.")
    assert not BACKWARD.search("The first of equal sets. By default all sets.")
    assert JOB_KEY.search("problem.forbidden must lie")
    assert JOB_KEY.search("give --draws")
    assert not JOB_KEY.search("pfdist.models.library.ungm --")
