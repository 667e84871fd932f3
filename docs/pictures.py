"""Make the pictures of README and manual, and `results/example`: ``python docs/pictures.py``.

It makes those whose code has changed since; with names of groups, it makes these anyway. A hash of
the code that draws a group is kept beside the pictures, and a test compares it. ``--unchanged``
notes that the code of today draws the same. It needs ``.[dev,bench]`` and Chromium.
"""

import argparse
import ast
import hashlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import tokenize
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt

import pfdist

DOCS = Path(__file__).parent
ROOT = DOCS.parent
NOTED = DOCS / "figures" / "drawn_by.json"
EXAMPLE = "results/example"
PROGRAM = "import sys; sys.argv[0] = 'pfdist'; from pfdist.cli.main import main; sys.exit(main())"
"""A run notes the command that began it, which shall not be a path of this machine."""

Pictures = dict[str, Path]
"""Files that were made, by their names in docs/figures."""


@dataclass(frozen=True)
class Group:
    """Pictures that are made together, and the files from which the code that draws them starts."""

    make: Callable[[], Pictures]
    code: tuple[str, ...]


def main(words: list[str]) -> None:
    """Make groups of pictures, and note the code that drew them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("groups", nargs="*", metavar="GROUP", help=", ".join(GROUPS))
    parser.add_argument("--unchanged", action="store_true", help="note the code, and draw nothing")
    asked = parser.parse_args(words)
    for name in asked.groups or stale():
        print(f"{name} ...", flush=True)  # noqa: T201  it takes minutes
        if not asked.unchanged:
            _make(GROUPS[name])
        text = json.dumps(_noted() | {name: code_of(name)}, indent=1, sort_keys=True)
        NOTED.write_text(f"{text}\n", encoding="utf-8")


def stale() -> list[str]:
    """The groups whose code is not that which drew their pictures."""
    noted = _noted()
    return [each for each in GROUPS if noted.get(each) != code_of(each)]


def _noted() -> dict[str, str]:
    noted: dict[str, str] = json.loads(NOTED.read_text(encoding="utf-8")) if NOTED.exists() else {}
    return noted


def code_of(group: str) -> str:
    """Hash of the code that draws a group, without docstrings and comments."""
    whole = hashlib.sha256()
    for path in sorted(_needed(GROUPS[group].code)):
        whole.update(path.encode())
        whole.update(_code(ROOT / "pfdist" / path))
    return whole.hexdigest()[:16]


def _needed(paths: tuple[str, ...]) -> set[str]:
    """Files of the package, and all modules of pages that they import."""
    needed, waiting = set[str](), [*paths]
    while waiting:
        path = waiting.pop()
        if path in needed:
            continue
        needed.add(path)
        if path.endswith(".py"):
            text = (ROOT / "pfdist" / path).read_text(encoding="utf-8")
            names = re.findall(r"^\s*from pfdist\.pages(?:\.| import )(\w+)", text, re.MULTILINE)
            waiting += [f"pages/{name}.py" for name in names if name != "plots"]
    return needed


def _code(path: Path) -> bytes:
    """The text of a file without docstrings and comments, the same with every Python."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".py":
        return text.encode()
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        match node:
            case ast.Module() | ast.ClassDef() | ast.FunctionDef() if ast.get_docstring(node):
                docstring = node.body[0]
                for row in range(docstring.lineno, (docstring.end_lineno or 0) + 1):
                    lines[row - 1] = ""
    return "\n".join(line.rstrip() for line in lines if line.strip()).encode()


# --- groups ---------------------------------------------------------------------------------------


def _make(group: Group) -> None:
    """Make pictures in a new folder that has the jobs, and put them into the manual."""
    before = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(ROOT / "jobs", Path(folder) / "jobs")
        os.chdir(folder)
        try:
            for name, path in group.make().items():
                shutil.copy(path, DOCS / "figures" / f"{name}.png")
        finally:
            os.chdir(before)


def _pfdist(*commands: str) -> None:
    """Do commands of pfdist, as a user does."""
    for command in commands:
        words = [sys.executable, "-c", PROGRAM, *shlex.split(command)]
        subprocess.run(words, check=True)  # noqa: S603  our own commands


def _play(page: str, section: str = "") -> None:
    """Do what a page or a section of it tells its reader to do, and print nothing that it shows."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    [part] = re.findall(rf"^## {section}.*?(?=^## |\Z)", text, re.M | re.S) if section else [text]
    names: dict[str, Any] = {}
    for language, block in re.findall(r"^```(\w+)\n(.*?)^```", part, re.M | re.S):
        first, _, rest = block.partition("\n")
        if file := re.fullmatch(r"# (\w+\.(?:py|toml|csv))", first):
            Path(file[1]).write_text(rest, encoding="utf-8")
        elif language == "python":
            exec(compile(block, f"{page}.md", "exec"), names)  # noqa: S102  the manual's own code
        elif language == "console":
            _pfdist(*re.findall(r"^\$ pfdist (.*)", block, re.MULTILINE))


def _blood() -> Pictures:
    _pfdist("plan jobs/blood.toml")
    return {"blood": Path("results/blood/figures/system.png")}


def _example() -> Pictures:
    """The finished run of jobs/quick.toml, which is kept whole."""
    _pfdist(f"run jobs/quick.toml --results {EXAMPLE} --no-report")
    shutil.rmtree(ROOT / EXAMPLE)
    shutil.copytree(EXAMPLE, ROOT / EXAMPLE)
    return {}


def _plan() -> Pictures:
    _pfdist(
        "plan jobs/plan.toml",
        "bound jobs/plan.toml",
        "why jobs/plan.toml",
        "compare jobs/plan.toml --times clinic=0,20,40,60 --times mine=0:60:3 --times regular",
        "budget jobs/quick.toml --measurements 12:20",
    )
    return {
        "plan-bound": Path("results/plan/figures/bound.png"),
        "plan-why": Path("results/plan/figures/why-relaxation.png"),
        "plan-compared": Path("results/plan-compare/figures/compared.png"),
        "plan-budget": Path("results/quick-budget/figures/budget.png"),
    }


def _paper() -> Pictures:
    _pfdist("run jobs/paper.toml", "online jobs/online.toml")
    figures = ("searches", "draw-genetic", "gain-genetic")
    made = {f"paper-{each}": Path(f"results/paper/figures/{each}.png") for each in figures}
    return made | {"paper-online_times": Path("results/online/figures/online_times.png")}


def _sensors() -> Pictures:
    _pfdist("plan jobs/two_compartments.toml")
    return {"two_compartments-times": Path("results/two_compartments/figures/times.png")}


def _lake() -> Pictures:
    _play("example")
    return {"lake.filtered": Path("lake.filtered.png")}


def _real_data() -> Pictures:
    _play("real-data", "A drug")
    [figure] = Path("results").glob("*/figures/backtest*.png")
    return {"remifentanil": figure}


def _particles() -> Pictures:
    numbers = (50, 100, 200, 500, 1000, 2000, 5000)
    losses = pfdist.particle_losses("jobs/constant_velocity.toml", numbers, draws=1000)
    with plt.style.context("pfdist.pages.screen"):
        figure, axes = plt.subplots(figsize=(6.4, 3.2), layout="constrained")
        pfdist.plots.particle_losses(losses, ax=axes)
        figure.savefig("particles.png", dpi=110)
    return {"particles": Path("particles.png")}


def _script(name: str, *words: str) -> Callable[[], Pictures]:
    """The maker of a group that has a script of its own, which puts pictures into the manual."""

    def make() -> Pictures:
        subprocess.run([sys.executable, DOCS / f"{name}.py", *words], check=True)  # noqa: S603
        return {}

    return make


def _explore() -> Pictures:
    _pfdist("plan jobs/pharmacokinetics.toml", "why jobs/pharmacokinetics.toml")
    return _script("explore_pictures", "results/pharmacokinetics")()


_EXPLORER = (
    "plugins/explorer/session.py",
    "plugins/explorer/explore.css",
    "plugins/explorer/explore.html",
    "plugins/explorer/explore.js",
)
_RUN = ("pages/system.py", "pages/gains.py", "pages/searches.py")
_PAGE = ("questions/report.py", "pages/page.html", "pages/style.css")
GROUPS = {
    "blood": Group(_blood, ("pages/system.py",)),
    "example": Group(_example, _RUN),
    "plan": Group(
        _plan,
        (
            "pages/bounds.py",
            "plugins/budget/figure.py",
            "plugins/why/figures.py",
            "pages/searches.py",
        ),
    ),
    "paper": Group(_paper, ("pages/searches.py", "pages/gains.py", "plugins/online/figure.py")),
    "sensors": Group(_sensors, ("pages/times_axis.py",)),
    "lake": Group(_lake, ("plugins/filter/figure.py",)),
    "real-data": Group(_real_data, ("plugins/backtest/figures.py",)),
    "particles": Group(_particles, ("plugins/check/figure.py",)),
    "gallery": Group(_script("gallery"), ("plugins/why/figures.py", "pages/times_axis.py")),
    "notebook": Group(_script("notebook_page"), _RUN),
    "report": Group(_script("report_picture"), (*_PAGE, "pages/system.py", "pages/bounds.py")),
    "explore": Group(_explore, _EXPLORER),
}

if __name__ == "__main__":
    main(sys.argv[1:])
