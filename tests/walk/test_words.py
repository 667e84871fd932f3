"""Names and prose of package and tests follow the house rules; each failure names file and line."""

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FILES, TESTS = (
    sorted(
        path.relative_to(ROOT).as_posix()
        for folder in folders
        for path in (ROOT / folder).rglob("*.py")
    )
    for folders in (("pfdist", "benchmarks"), ("tests",))
)
VAGUE = {"its", "one", "of", "no", "by"}

JOB_KEY = re.compile(
    r"(?<![\w./])(problem|model|filter|evaluation|comparison|budget|search|execution)\.[a-z]\w+"
    r"|(?<![\w-])--[a-z]"
)
BACKWARD = re.compile(r"(?:\A|\n\s*\n|(?<=[.:?!])\s+|\n    )(?:Of|What|By(?! default))\s[^.]*")
LOW_ROOMS = ("pfdist/times/", "pfdist/models/", "pfdist/search/")


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


@pytest.mark.parametrize("file", FILES + TESTS)
def test_variables_have_nouns_for_names(file: str) -> None:
    found = list(vague_names((ROOT / file).read_text()))
    assert not found, f"{file} has vague names: {', '.join(found)}"


@pytest.mark.parametrize("file", FILES + TESTS)
def test_no_sentence_is_built_backwards(file: str) -> None:
    found = [
        f"{line}: {match[0].strip()[:60]}"
        for line, text in prose((ROOT / file).read_text())
        for match in BACKWARD.finditer(text)
    ]
    assert not found, f"{file} has sentences that begin with Of, What or By: {', '.join(found)}"


@pytest.mark.parametrize("file", [file for file in FILES if file.startswith(LOW_ROOMS)])
def test_low_floors_name_no_job_key_and_no_option_in_messages(file: str) -> None:
    found = [
        f"{line}: {match[0]}"
        for line, text in messages((ROOT / file).read_text())
        if (match := JOB_KEY.search(text))
    ]
    assert not found, f"{file} names job keys or options: {', '.join(found)}"


def test_the_checks_find_what_they_look_for() -> None:
    found = sorted(vague_names("def f(its):\n    return [one.by for one in its]"))
    assert found == ["1: its", "2: by", "2: its", "2: one", "2: one"]
    assert BACKWARD.search("A set.\n\nOf equal sets the first is given.")
    assert not BACKWARD.search("The first of equal sets. By default all sets.")
    assert JOB_KEY.search("problem.forbidden must lie")
    assert JOB_KEY.search("give --draws")
    assert not JOB_KEY.search("pfdist.models.ungm --")
