"""Each key of noise has the unit over which results are averaged."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pfdist
from pfdist.common.parsing import parse_toml
from pfdist.plugins import PLUGINS

ROOMS = "filters", "questions", "runner"
# Functions that make a key, that give it to noise, and that make one from a seed.
MAKERS = {
    "stream_of", "stream_key", "generator", "variates", "noise_of", "log_evidence",
    "Filter", "OneFilter", "filter_of", "Planner", "Replanner",
}  # fmt: skip
# For each function that calls one of these: the unit over which results are averaged, and the words
# by which the calls say it. "draws" without a word: the key is that of a whole stream, in which
# each draw has its number. "hash": no noise has this key.
UNITS = {
    "filters/cloud.py Cloud.starts": "draw: draws self.t",
    "filters/cloud.py Cloud.chosen_for_filters": "draw: draws self.t",
    "filters/draws.py _given": "draw: draw.index t",
    "filters/draws.py noise_of": "draw: draws t component",
    "filters/evaluator.py Evaluator.id_of": "hash:",
    "filters/linearized.py _noise": "draw: index t",
    "runner/filter.py Filter._start": "system: seed draw",
    "filters/filter_estimate.py surprise_of_particles": "system, instant: draw cloud.t component",
    "filters/one_filter.py Followed.__init__": "system, whose number stays: unmeasured.stream",
    "filters/constants.py _found": "nothing, it only looks for constants:",
    "filters/one_filter.py Followed.again": "cloud: again number",
    "filters/plain.py simulate": "draw: index t",
    "filters/plain.py first": "draw: draws.index",
    "filters/plain.py step": "draw: draws t",
    "filters/predicted.py circular_measurements": "nothing, it only looks for angles:",
    "filters/scenarios.py scenarios_of_draws": "block of draws: begins",
    "filters/work.py filter_streams": "draws: stream",
    "questions/evaluate.py prepare_evaluation": "draws: fresh",
    # Replicates with the same parameters have numbers. Groups of them share the numbers, which
    # changes neither the mean of the log evidence nor clearly its error.
    "questions/planned_run.py system_of_table": "nothing, it is one system:",
    "questions/planned_run.py filter_of": "system: draw",
    "runner/block_sums.py grown": "draws:",
    "runner/choice.py with_long_gap": "nothing, it is one choice:",
    "runner/choice.py steps_a_particle": "draws: pilot",
    "runner/comparison_phase.py _work": "draws: first times",
    "runner/comparison_phase.py of_aspect": "draws: aspect.table",
    "runner/design.py linearized_of": "draws:",
    "runner/design.py design_of": "starts of one search:",
    "runner/door.py WorkBatch._tasks": "hash:",
    "runner/evenly_spaced.py _Scan._judged": "draws: times",
    "runner/evenly_spaced.py _Scan._look": "draws:",
    "runner/gap_terms.py gap_terms": "draws:",
    "runner/gap_terms.py _per_draw": "draws: draws_stream",
    "runner/likelihood.py measured": "state: draw t component",
    "runner/particles.py lost_constants": "draws: role",
    "runner/particles.py work_of_loss": "draws: role",
    "runner/phase.py Phase.stream": "draws: self.name keyed_by",
    "runner/phase.py run_phase": "generation: name generation",
    "runner/prover.py Prover._windows": "draws:",
    "runner/prover.py Prover._streams": "draws:",
    "runner/ranks.py RankWork._statistics": "draw: index t c",
}


def words_of(function: ast.FunctionDef) -> set[str] | None:
    """The words in the arguments of the calls that make keys; None if there are no such calls.

    ``*parts`` has the words of what the function assigns to ``parts``.
    """
    nodes = [*ast.walk(function)]
    made = [node for node in nodes if isinstance(node, ast.Call)
            and ast.unparse(node.func).rpartition(".")[2] in MAKERS]  # fmt: skip
    given = [part for call in made for part in (*call.args, *call.keywords)]
    starred = {ast.unparse(each.value) for each in given if isinstance(each, ast.Starred)}
    given += [node.value for node in nodes if isinstance(node, ast.Assign)
              and starred & {ast.unparse(target) for target in node.targets}]  # fmt: skip
    kinds = ast.Name | ast.Attribute | ast.Constant
    words = (ast.unparse(each) for part in given for each in ast.walk(part)
             if isinstance(each, kinds))  # fmt: skip
    return {word.strip("'") for word in words} if made else None


def functions(tree: ast.AST, name: str = "") -> Iterator[tuple[str, ast.FunctionDef]]:
    """Yield functions and methods with their names; a function within one belongs to it."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.FunctionDef):
            yield name + node.name, node
        elif isinstance(node, ast.ClassDef):
            yield from functions(node, f"{node.name}.")


def test_each_place_that_makes_a_key_says_over_what_it_averages() -> None:
    found = dict[str, set[str]]()
    package = Path(pfdist.__file__).parent
    for room in (*ROOMS, *(f"plugins/{name}" for name in PLUGINS)):
        for file in (package / room).glob("*.py"):
            for name, function in functions(ast.parse(file.read_text(encoding="utf-8"))):
                if (words := words_of(function)) is not None:
                    found[f"{room}/{file.name} {name}"] = words
    units = {**UNITS}
    for keys in (Path(__file__).parents[1] / "plugins").glob("*/keys.toml"):
        own = parse_toml(keys.read_text(encoding="utf-8"))
        units |= {f"plugins/{keys.parent.name}/{place}": unit for place, unit in own.items()}
    assert found.keys() == units.keys()
    for place, unit in units.items():
        lacking = {*unit.partition(":")[2].split()} - found[place]
        assert not lacking, (place, unit)
