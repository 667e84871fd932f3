"""Write the tables of the manual that are made from declarations: ``python docs/tables.py``.

A page marks the place of a table by two comments, ``<!-- table: NAME -->`` and ``<!-- end -->``.
The command replaces the lines between them. A test fails if a page has an old table.
"""

import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import numpy as np
import pandas as pd
import pyarrow as pa
from cyclopts.argument import Argument
from pydantic.fields import FieldInfo

import pfdist
from pfdist.cli.commands import COMMANDS
from pfdist.cli.program import program
from pfdist.cli.words import FLAGS, shown_default
from pfdist.common.component_names import Component
from pfdist.common.plugins import added, plugins
from pfdist.common.rounding import rounded, with_error
from pfdist.common.section import JobSection, keys_of_section
from pfdist.densities import DENSITIES
from pfdist.filters.aspects import DISTANCE, VARIANCE
from pfdist.filters.beside import BESIDE
from pfdist.filters.criterion import CRITERIA
from pfdist.filters.engines import AUTO, ENGINES
from pfdist.kernels.schemes import SCHEMES
from pfdist.pages.figure import FIGURES
from pfdist.problem.added_sections import added_sections
from pfdist.problem.clock_section import ClockSection
from pfdist.problem.job import Job
from pfdist.problem.job_schema import documented
from pfdist.problem.limits_section import MostWithinSection, StoreSection
from pfdist.problem.methods import METHODS
from pfdist.problem.needs import capabilities
from pfdist.problem.problem_section import ProblemSection
from pfdist.problem.scenarios_section import Scenarios
from pfdist.problem.search_section import CommonNoiseSettings, EvaluationSettings, SearchSection
from pfdist.problem.sections import (
    DEFAULT_METHOD,
    Comparison,
    EvaluationSection,
    Execution,
    FilterModel,
    FilterSection,
    Model,
)
from pfdist.problem.sensing_section import MeasurementsSection
from pfdist.problem.sensor_section import SensorSection
from pfdist.problem.visits_section import VisitsSection
from pfdist.results.columns import COLUMNS as SET_COLUMNS
from pfdist.results.run import COMPUTED
from pfdist.runner.comparison_phase import schema_of_aspect
from pfdist.store.schema import (
    KEYS,
    comparison_schema,
    filtered_schema,
    schema,
    trajectories_schema,
)

FOLDER = Path(__file__).parent
ASPECTS = (
    *reversed(BESIDE), DISTANCE, VARIANCE,
    *(aspect for form in CRITERIA.values() for aspect in form.aspects),
)  # fmt: skip
BENCHMARKS = FOLDER.parent / "benchmarks" / "results"
_NAMES_OF_PLUGINS = "# Names of plugins, written by docs/tables.py\n"
STUBS = {
    FOLDER.parent / "pfdist" / "__init__.pyi": "names",
    FOLDER.parent / "pfdist" / "pages" / "plots.pyi": "plots",
}
NAMES: dict[str, dict[str, str]] = {
    "models": {
        "StateSpaceModel": 'pfdist.StateSpaceModel(name="walk", **formulas)',
        "Sensor": 'pfdist.Sensor(measurement, log_likelihood, ("normal",), price=1)',
        "load_model": 'pfdist.load_model("mine.py:model")',
        "linear_gaussian": 'pfdist.linear_gaussian("cart", transition=F, **matrices)',
        "BatchedModel": 'pfdist.BatchedModel(name="growth", version="1", **functions)',
        "ode": "pfdist.ode(lambda x, t, p: (-p.rate * x[0],))",
        "sde": "pfdist.sde(drift, diffusion, noises=1)",
        "where": "pfdist.where(x[0] > 0, x[0], 0.0)",
        "clip": "pfdist.clip(x[0], 0.0, 1.0)",
        "take": "pfdist.take(table, x[0].astype(int))",
        "Problem": 'pfdist.Problem("ungm", horizon=60, measurement_budget=21)',
        "Job": 'pfdist.load_job("jobs/plan.toml").with_changes(["seed=3"])',
        "load_job": 'pfdist.load_job("jobs/plan.toml")',
    },
    "plan": {
        "plan": "run = pfdist.plan(problem)",
        "Options": "pfdist.plan(problem, workers=4, report=False)",
        "run": 'pfdist.run("jobs/quick.toml")',
        "evaluate": 'pfdist.evaluate(problem, "0:60:3").expected_mse',
        "compare": 'pfdist.compare(problem, times={"mine": "0:60:3"}).table("pairs")',
        "bound": "pfdist.bound(problem, draws=7680)",
    },
    "runs": {
        "open_run": 'run = pfdist.open_run("results/quick")',
        "Run": 'run.best.measurement_times; run.table("sets")',
        "Evaluation": "evaluation.expected_mse, evaluation.standard_error",
        "report": "pfdist.report(run)",
    },
    "data": {
        "Filter": 'pfdist.Filter("ungm", particles=500).update(3, 12.5)',
        "Cloud": 'pfdist.Filter("ungm", prior=filtering.cloud)',
    },
    "figures": {
        "plots": "pfdist.plots.times(run)",
    },
    "densities": {
        "densities": "pfdist.densities.poisson_logpmf(y[0], mean)",
    },
    "errors": {
        "PfdistError": "pfdist.PfdistError",
    },
}
"""Names of the package that the core has, with an example, by their page of the API."""
LISTED = {name: method for name, method in METHODS.items() if method.listed}
"""The search methods that the manual offers."""
UNLISTED = METHODS.keys() - LISTED
_MEMBERS = {"Job": " with_changes"}  # of a class, unless all are described
_COMMON = {"name", "method", "evaluation", "polish"}  # keys that every search has
_BOUNDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}
_SHARED = 2  # commands that have an option with the same words
_EXAMPLES = 1  # of a command; its help has all
_COMMON_COLUMNS = 3  # tables that have a column with the same words
_JOB = re.compile(  # the page says it once
    r"A job file,( as `jobs/plan.toml`,| whose run is meant,)? or the folder of a run\.\s*"
)
_UNBOUNDED = 2**63  # whole numbers of a job have 64 bits
_SHARES = re.compile(r"\d+(?:, \d+)*(?= ?%)")
_MARKED = re.compile(r"(?s)(<!-- table: (\w+) -->\n).*?(<!-- end -->)")
_SECTIONS: Mapping[str, type[JobSection]] = {
    "[model]": Model,
    "[model.filter]": FilterModel,
    "[problem]": ProblemSection,
    "[problem.clock]": ClockSection,
    "[problem.sensors.NAME]": SensorSection,
    "[problem.visits]": VisitsSection,
    "[problem.store]": StoreSection,
    "[problem.most_within]": MostWithinSection,
    "[problem.measurements]": MeasurementsSection,
    "[filter]": FilterSection,
    "[evaluation]": EvaluationSection,
    "[scenarios]": Scenarios,
    "[[search]]": SearchSection,
    "[search.evaluation]": EvaluationSettings,
    "[comparison]": Comparison,
    **{f"[{key}]": section for key, section in added_sections().items()},
    "[execution]": Execution,
}
_KINDS = {bool: "true or false", int: "whole number", float: "number", str: "text", Any: "value"}
_COMMON_DEFAULTS = CommonNoiseSettings().model_dump(exclude_none=True)
_MODEL = (Component("0"),)  # of a model without names
_ROWS = {
    "evaluations": "each evaluation of a search",
    "draws": "each draw of each evaluation, and of the compared sets alone where there is a bound",
    "compared": "each compared set",
    "comparison": "each draw, with a column for each SET; all sets filter the same draws",
    "range_sums": "each compared set and range of draws, about 32 to 64 ranges for each set",
    "other_estimate": "each of the first draws, at most a fifth of them, with a column for each "
    "SET: `filtered_SET` if the job's own estimate is smoothed",
    "filter_distance": "up to 1,000 of these draws, with a column for each SET",
    "filter_variance": "up to 1,000 of these draws, with a column for each SET",
    "information": "the same draws, with a column for each SET, if it is wanted",
    "information_gap": "up to 1,000 of these draws, with a column for each SET",
    "online": "each draw whose times are chosen one after another",
    "trajectories": "each instant of the first 100 draws of the comparison",
    "timings": "each task; the one table that may differ between two runs of one job",
    "bound": "each set and each proof of a lower bound",
    "error_sums": "each block of 24 draws of a relaxation",
    "evenly_spaced": "each number of evenly spaced measurements that was tried",
    "profile": "each compared set and instant, by `pfdist why`",
    "worth": "each compared set and measurement, by `pfdist why`",
    "sampling_windows": "each compared set, measurement and tried instant, by `pfdist why`",
}


def methods() -> str:
    """Give the table of search methods."""
    rows = []
    for name, method in LISTED.items():
        section = method.section()
        noise = section.evaluation.noise or "as the job"
        rows.append(
            [
                f"`{name}`" + (" (default)" if name == DEFAULT_METHOD else ""),
                _sentence(method.description),
                noise,
                "yes" if section.polish else "no",
            ]
        )
    return _table(["method", "how it searches", "noise", "polish"], rows)


def settings() -> str:
    """Give the table of the settings of all search methods, with defaults and bounds."""
    rows = [
        [f"`{name}`", f"`{key}`", _value(field.default), _bounds(field), described[key]]
        for name, method in LISTED.items()
        for described in (_described(method.optimiser),)
        for key, field in method.section.model_fields.items()
        if key not in _COMMON
    ]
    return _table(["method", "setting", "default", "bounds", "meaning"], rows)


def keys() -> str:
    """Give the tables of all keys of a job, a table for each section."""
    seed = {"seed": Job.model_fields["seed"]}
    tables = [_table_of_keys("Above all sections", seed, Job)]
    for head, section in _SECTIONS.items():
        tables.append(_table_of_keys(f"`{head}`", keys_of_section(section), section))
    return "\n\n".join(tables)


def keys_of_files() -> str:
    """Give the tables of the keys of files that plugins read, a table for each."""
    return "\n\n".join(_table_of_keys("", each.model_fields, each) for each in added("files"))


def columns() -> str:
    """Give the tables of all columns of the tables of a run."""
    schemas = {
        "compared": schema(
            "compared", "tried", "exact_mse", "exact_information", "exact_other_mse"
        ),
        "bound": schema("bound", "shares"),
        "comparison": comparison_schema(["SET"], with_control=True, with_scenarios=True),
        **{each.table: schema_of_aspect(each, ["SET"]) for each in ASPECTS},
        "trajectories": trajectories_schema(["SET"], _MODEL, _MODEL),
    }
    rows = {name: _rows_of_columns(schemas.get(name) or schema(name)) for name in KEYS}
    counts = Counter(row for each in rows.values() for row in each)
    common = [row for row, count in counts.items() if count >= _COMMON_COLUMNS]
    head = ["column", "meaning [unit]"]
    parts = [f"## Columns that several tables share\n\n{_table(head, map(list, common))}"]
    for name, identifying in KEYS.items():
        key = ", ".join(f"`{column}`" for column in identifying)
        also = ", ".join(row[0] for row in rows[name] if row in common)
        own = [list(row) for row in rows[name] if row not in common]
        parts.append(
            f"## `{name}`\n\nA row for {_ROWS[name]}. Key: {key}."
            + f" Also {also}." * bool(also)
            + f"\n\n{_table(head, own)}"
        )
    return "\n\n".join(parts)


def computed_tables() -> str:
    """Give a section for each table of a run that follows from others."""
    sections = [f"## `{name}`\n\n{inspect.getdoc(function)}" for name, function in COMPUTED.items()]
    rows = [
        (f"`{name}`" + (", `_low`, `_high`" if column.has_interval else ""), column.meaning)
        for name, column in SET_COLUMNS.items()
        if not name.endswith(("_low", "_high")) or name == "bound_low"
    ]
    sections[0] += "\n\n" + _table(["column", "meaning"], map(list, _together(rows)))
    return "\n\n".join(sections).replace("``", "`")


def filtered_columns() -> str:
    """Give the table of the columns of filtered measurements."""
    rows = _rows_of_columns(filtered_schema(_MODEL))
    return _table(["column", "meaning [unit]"], map(list, rows))


def arguments_of(name: str) -> Iterator[tuple[str, str]]:
    """Give each argument of a command but its flags, as it is typed, and what it means."""
    for argument in program()[name].assemble_argument_collection(parse_docstring=True):
        if argument.name.removeprefix("--") in FLAGS:
            continue
        meaning = " ".join((argument.parameter.help or "").replace("``", "`").split())
        each = [choice for choice in argument.get_choices() or () if choice not in UNLISTED]
        choices = f" Choices: {', '.join(each)}." if each else ""
        default = shown_default(argument.field_info.default)
        yield (
            ", ".join(_spelling(argument)),
            meaning + choices + (f" (default: {default})" if default else ""),
        )


def _spelling(argument: Argument) -> list[str]:
    metavar = argument.parameter.metavar or ""
    if argument.index is not None:
        return [metavar]
    return [" ".join(filter(None, [name, metavar])) for name in argument.names]


def _line(name: str) -> str:
    """Give a command with its files, and the options that must be given."""
    words = ["pfdist", name]
    for each in program()[name].assemble_argument_collection():
        if each.required:
            words += _spelling(each)[:1]
        elif each.index is not None:
            several = " ..." if each.field_info.kind is inspect.Parameter.VAR_POSITIONAL else ""
            words.append(f"[{_spelling(each)[0]}{several}]")
    return " ".join(words)


def usage() -> str:
    """Give all arguments and examples of each command, from its function."""
    arguments = {
        name: [(f"`{words}`", _escaped(text)) for words, text in arguments_of(name)]
        for name in COMMANDS
    }
    counts = Counter(row for rows in arguments.values() for row in rows)
    shared = [row for row, count in counts.items() if count >= _SHARED and row[0] != "`JOB`"]
    head = ["argument", "meaning"]
    flags = [[f"`--{name}`", text] for name, text in FLAGS.items()]
    parts = [
        f"## Options of every command\n\n{_table(head, flags)}",
        f"## What several commands share\n\n{_table(head, map(list, shared))}",
    ]
    for name, rows in arguments.items():
        own = [
            [words, _JOB.sub("", text)]
            for words, text in rows
            if (words, text) not in shared and _JOB.sub("", text)
        ]
        also = ", ".join(
            f"`{row[0].strip('`').split()[0].rstrip(',')}`" for row in rows if row in shared
        )
        examples = "\n".join(
            f"{line}    # {does}" for line, does in [*COMMANDS[name].examples.items()][:_EXAMPLES]
        )
        parts.append(
            f"## {name}"
            + f"\n\n{_table(head, own)}" * bool(own)
            + f"\n\nAlso {also}." * bool(also)
            + f"\n\n```\n{examples}\n```" * bool(examples)
        )
    return "\n\n".join(parts)


def gallery() -> str:
    """Give the table of the gallery, which ``python docs/gallery.py`` computes."""
    rows = [
        [
            f"`{row.job}`",
            with_error(row.regular, row.regular_error),
            with_error(row.found, row.found_error),
            f"{100 * row.gain:.0f} % ({100 * row.gain_low:.0f} to {100 * row.gain_high:.0f})",
        ]
        for row in pd.read_csv(FOLDER / "gallery.csv").itertuples()
    ]
    head = [
        "job",
        "expected MSE ± standard error, evenly spaced",
        "plan",
        "lower by (95 %)",
    ]
    return _table(head, rows)


def genetic() -> str:
    """Give the table of the paper's genetic algorithm with fifteen seeds, from its benchmark."""
    searches = pd.read_csv(BENCHMARKS / "genetic.csv", comment="#").set_index("name")
    searches["of_means"] = 1 - searches["cost"] / searches.loc["regular", "cost"]
    best, regular = searches.loc["best known"], searches.loc["regular"]
    seeds = searches.drop(["best known", "regular"])

    def over_seeds(values: pd.Series, digits: int) -> str:
        mean, low, high = (f"{value:.{digits}f}" for value in values.agg(["mean", "min", "max"]))
        return f"{mean} ({low} to {high})"

    costs = over_seeds(seeds["cost"], 2)
    columns = ("of_means", "gain", "positive")
    shares = [over_seeds(100 * seeds[column], 1) for column in columns]
    known = [f"{100 * best[column]:.1f}" for column in columns]
    rows = [
        [
            "the genetic algorithm, fifteen seeds: mean (range)",
            f"{regular.cost:.2f}",
            costs,
            *shares,
        ],
        ["the best set known", f"{regular.cost:.2f}", f"{best.cost:.2f}", *known],
        ["the paper prints", "31.08", "", "", "27.7", "87.5"],
    ]
    head = [
        "search",
        "expected MSE, regular times",
        "expected MSE, found times",
        "gain of means, %",
        "mean relative gain, %",
        "draws with a gain, %",
    ]
    return _table(head, rows)


def seconds_of_plan() -> str:
    """Give the table of where the seconds of a plan go."""
    parts = pd.read_csv(BENCHMARKS / "seconds_of_plan.csv", comment="#")
    rows = [[row.part, f"{row.seconds:.1f}"] for row in parts.itertuples()]
    return _table(["part", "s"], [*rows, ["all", f"{parts['seconds'].sum():.1f}"]])


def backtest() -> str:
    """Give the table of the verdicts of backtests, from their benchmark."""
    table = pd.read_csv(BENCHMARKS / "backtest.csv", comment="#")
    table = table[table["grid"] == "centred"]
    rows = []
    for name, case in table.groupby("case", sort=False):
        ratio, by_size = round(float(case["ratio"].iloc[0]), 3), case.set_index("replicates")
        right = {"kept": ratio >= 0.5, "not_kept": ratio <= 0.5}  # at 0.5, neither is
        verdicts = [verdict for verdict, is_right in right.items() if is_right]
        shares = 100 * by_size[verdicts].sum(axis=1)
        wrong = (f"{100 * by_size['wrong'][size]:.1f}" for size in (20, 100))
        rows.append([str(name), f"{ratio:.2f}".replace("-0.00", "0.00"), " or ".join(
            each.replace("_", " ") for each in verdicts), *(f"{each:.1f}" for each in shares),
            *wrong])  # fmt: skip
    sizes = table["replicates"].unique()
    head = ["measurements", "true ratio", "verdict", *(f"% of {size}" for size in sizes)]
    return _table([*head, "wrong, % of 20", "wrong, % of 100"], rows)


def guided() -> str:
    """Give the table of plain and guided filters, from their benchmark."""
    cases = pd.read_csv(BENCHMARKS / "guided.csv", comment="#")
    cases = cases[~cases["system"].str.contains("without t = 0")]
    rows = []
    for system, pair in cases.groupby("system", sort=False):
        plain, other = (row for _, row in pair.iterrows())
        rows.append(
            [
                f"{system}, {plain['noise']}, P = {plain['particles']}",
                *(
                    f"{100 * row['excess']:+.1f} ± {100 * row['excess_error']:.1f} %"
                    for row in (plain, other)
                ),
                f"{other['ns'] / plain['ns']:.1f}",
            ]
        )
    head = ["system, noise", "plain", "guided", "times the time"]
    return _table(head, rows)


def constants() -> str:
    """Give the table of particle-steps that unknown constants need, from their benchmark."""
    table = pd.read_csv(BENCHMARKS / "constants.csv", comment="#")
    proposals = [*dict.fromkeys(table["proposal"])]
    rows = list[list[str]]()
    for system, own in table.groupby("system", sort=False):
        cells = list[str]()
        for proposal in proposals:
            tried = own[own["proposal"] == proposal]
            if not len(tried):
                cells.append("not possible")
                continue
            last = tried.iloc[-1]
            steps = f"{last['steps']:,.0f} ({last['particles']:,.0f})"
            is_enough = last["excess"] + last["excess_error"] < 0.05
            cells.append(steps if is_enough else f"{100 * last['excess']:+,.0f} % with {steps}")
        rows.append([str(system), *cells])
    return _table(["system", *proposals], rows)


def static() -> str:
    """Give the table of static posteriors, from their benchmark."""
    table = pd.read_csv(BENCHMARKS / "static.csv", comment="#")
    rows = [
        [row["program"], f"{row['particles']:,}", f"{row['excess']:.3f}", f"{row['ms']:.1f}"]
        for _, row in table.iterrows()
    ]
    return _table(["program", "particles", "excess", "ms a posterior"], rows)


def designs() -> str:
    """Give the table of plans beside linearized designs, from their benchmark."""
    table, rows = pd.read_csv(BENCHMARKS / "designs.csv", comment="#"), list[list[str]]()
    others = [each for each in dict.fromkeys(table["times"]) if each != "plan"]
    for system, own in table.groupby("system", sort=False):
        by_set = own.set_index("times")
        cells = [str(system), f"{float(by_set['mse']['plan']):.4g}"]
        for name in others:
            above, error = (
                float(by_set[each].get(name, np.nan)) for each in ("above", "above_error")
            )
            same = by_set["t"].get(name) == by_set["t"]["plan"]
            cells.append("the same" if same else f"{100 * above:+.1f} ± {100 * error:.1f} %")
        rows.append(cells)
    return _table(["system", "expected MSE of the plan", *others], rows)


def size() -> str:
    """Give the table of the time and memory of large problems, from their benchmark."""
    rows = list[list[str]]()
    for varied, own in pd.read_csv(BENCHMARKS / "size.csv", comment="#").groupby(
        "varied", sort=False
    ):
        columns = own[["value", "seconds", "mebibytes"]]
        steps = np.log(columns.iloc[-1] / columns.iloc[0])
        listed = ["; ".join(f"{each:,.0f}" for each in own[name]) for name in columns]
        rows.append([str(varied), *listed, *(f"{each / steps.iloc[0]:.2f}" for each in steps[1:])])
    head = ["what grows", "sizes", "processor time, s", "MiB", "exponent of time", "of memory"]
    return _table(head, rows)


def rules() -> str:
    """Give the table of rules against plans and the bound, and replanning, from their benchmark."""
    kinds, table = ("plan", "constant"), pd.read_csv(BENCHMARKS / "rules.csv", comment="#")
    rows = [
        [f"`{row['job']}`, {row['budget']:g}{' at most' * row['is_hard']}, {row['draws']:,}",
         *(with_error(row[f"{kind}_mse"], row[f"{kind}_error"]) for kind in kinds),
         *([with_error(row["rule_mse"], row["rule_error"]),
            with_error(100 * row["plan_excess"], 100 * row["plan_excess_error"])]
           if row["plan_excess_error"] else ["the plan", "0"]),
         rounded(row["bound"])]
        for row in table[table["online_mse"].isna()].to_dict("records")
    ]  # fmt: skip
    head = [
        "job, N, draws", "plan ± SE", "one threshold ± SE", "the rule ± SE",
        "less plan, % ± SE", "any strategy, at least",
    ]  # fmt: skip
    replanned = [
        f"With {row['budget']:g} measurements at most, replanning has "
        f"{with_error(row['online_mse'], row['online_error'])} on {row['draws']:,} draws; the "
        "rule's error is "
        f"{with_error(100 * abs(row['online_excess']), 100 * row['online_excess_error'])} % "
        f"{'above' if row['online_excess'] > 0 else 'below'}."
        for row in table.dropna(subset="online_mse").to_dict("records")
    ]
    return "\n\n".join([_table(head, rows), *replanned])


def engines() -> str:
    """Give the table of engines."""
    rows = [[f"`{engine.name}`", _sentence(engine.description)] for engine in ENGINES.values()]
    choice = "The engine `compiled`, or `batched` for a batched model"
    return _table(["engine", "what computes"], [[f"`{AUTO}` (default)", choice], *rows])


def schemes() -> str:
    """Give the table of resampling schemes."""
    rows = [[f"`{scheme.name}`", _sentence(scheme.description)] for scheme in SCHEMES.values()]
    return _table(["scheme", "how particles are resampled"], rows)


def needs() -> str:
    """Give the table of what each capability needs."""
    rows = [
        [
            each.title,
            "; ".join(fact.head + f" ({why})" * bool(why) for fact, why in each.needs.items()),
        ]
        for each in capabilities()
    ]
    return _table(["capability", "it needs"], rows)


def commands() -> str:
    """Give the table of commands, each with the arguments that must be given."""
    rows = [[f"`{_line(name)}`", _sentence(command.sentence)] for name, command in COMMANDS.items()]
    return _table(["command", "what it does"], rows)


def figures() -> str:
    """Give the table of a run's figures."""
    rows = [
        [f"`{name}-SET`" if figure.each_set else f"`{name}`", _sentence(figure.description)]
        for name, figure in FIGURES.items()
    ]
    return _table(["file", "what it shows"], rows)


def densities() -> str:
    """Give the table of densities."""
    rows = [
        [f"`{name}`", ", ".join(each.parameters), each.support, " and ".join(each.noise)]
        for name, each in DENSITIES.items()
    ]
    return _table(["density", "parameters", "support", "draw from"], rows)


def _names(*pages: str) -> str:
    """Give the table of names that some pages of the API describe."""
    rows = [
        [f"[`{name}`](api-{page}.md)", f"`{example}`"]
        for page in pages
        for name, example in _examples_on(page).items()
    ]
    return _table(["name", "example"], rows)


def _api(page: str) -> str:
    """Give the directives by which Sphinx describes the names of a page."""
    lines = []
    for name in _examples_on(page):
        if not isinstance(getattr(pfdist, name), type):
            lines.append(f".. autofunction:: pfdist.{name}")
            continue
        lines += [f".. autoclass:: pfdist.{name}", f"   :members:{_MEMBERS.get(name, '')}"]
    return "\n".join(["```{eval-rst}", *lines, "```"])


def _examples_on(page: str) -> dict[str, str]:
    added_names = {
        target.partition(":")[2]: name.example
        for each in plugins().values()
        for target, name in each.names.items()
        if name.page == page
    }
    return NAMES[page] | added_names


TABLES: dict[str, Callable[[], str]] = {
    table.__name__: table
    for table in (
        methods, settings, keys, keys_of_files, columns, computed_tables, filtered_columns, usage,
        gallery, genetic, backtest, guided, constants, static, designs, size,
        seconds_of_plan, rules, engines, schemes, commands, figures,
        densities, needs,
    )
}  # fmt: skip
TABLES |= {f"names_{page}": partial(_names, page) for page in ("models", "plan", "runs")}
TABLES["names_data"] = partial(_names, "data", "figures", "densities", "errors")
TABLES |= {f"api_{page}": partial(_api, page) for page in ("models", "plan", "runs", "data")}


def with_tables(page: str) -> str:
    """Give the text of a page with all its tables made anew."""
    return _MARKED.sub(lambda found: f"{found[1]}{TABLES[found[2]]()}\n{found[3]}", page)


def _described(documented: type) -> dict[str, str]:
    """Give the meaning of each key, from the docstring."""
    return {name: meaning for name, (_, meaning) in _documented(documented).items()}


def _documented(section: type) -> dict[str, tuple[str, str]]:
    """Give the unit and the meaning of each key."""
    return {
        name: (kind.partition(", ")[2], _sentence(meaning).replace("``", "`"))
        for name, (kind, meaning) in documented(section).items()
    }


def _table_of_keys(head: str, fields: Mapping[str, FieldInfo], section: type[JobSection]) -> str:
    described = _documented(section)
    rows = []
    for key, field in fields.items():
        if not _is_section(field.annotation):
            unit, meaning = described[key]
            allowed = "any [method](searches.md)" if key == "method" else _bounds(field)
            allowed += f"; {unit}" * bool(unit)
            rows.append([f"`{key}`", allowed, _default(key, field), meaning])
    title = f"## {head}\n\n" if head else ""
    return title + _table(["key", "allowed; unit", "default", "meaning"], rows)


def _default(key: str, field: FieldInfo) -> str:
    if key == "method":
        return f"`{DEFAULT_METHOD}`"
    if key in _COMMON_DEFAULTS and field.default is None:
        return f"the job's; under common noise {_value(_COMMON_DEFAULTS[key])}"
    if field.is_required():
        return "required"
    default = field.get_default(call_default_factory=True)
    if isinstance(default, SearchSection):
        return f"method `{default.method}`"
    return "" if default in (None, "", {}, [], ()) else _value(default)


def _rows_of_columns(columns: pa.Schema) -> list[tuple[str, ...]]:
    rows = []
    for column in columns:
        unit, description = (column.metadata[key].decode() for key in (b"unit", b"description"))
        unit = "" if unit == column.name else unit.replace("square of z's unit", "z²")
        rows.append((f"`{column.name}`", _escaped(description) + f" [{unit}]" * bool(unit)))
    return _together(rows)


def _together(rows: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """Put a column and its standard error into one row, and columns that differ in a percentage."""
    made = list[tuple[str, ...]]()
    for row in rows:
        (name, *kind, meaning), (first, *_, before) = row, made[-1] if made else ("", "")
        shares = [_SHARES.search(text) for text in (before, meaning)]
        if name == first[:-1] + "_error`" and meaning.startswith("standard error of "):
            made[-1] = (f"{first}, {name}", *kind, before)
        elif all(shares) and _SHARES.sub("", before) == _SHARES.sub("", meaning):
            listed = ", ".join(dict.fromkeys(share[0] for share in shares if share))
            made[-1] = (f"{first}, {name}", *kind, _SHARES.sub(listed, meaning))
        else:
            made.append(row)
    return made


def _bounds(field: FieldInfo) -> str:
    """Give the allowed values of a key in words."""
    return _limits(field.metadata) or _allowed(field.annotation)


def _limits(metadata: Iterable[Any]) -> str:
    parts = []
    for bound in metadata:
        for key, words in _BOUNDS.items():
            limit = getattr(bound, key, None)
            if limit is not None and limit != _UNBOUNDED:
                parts.append(f"{words} {_value(limit)}")
        if multiple := getattr(bound, "multiple_of", None):
            parts.append("even" if multiple == 2 else f"a multiple of {multiple}")
    return ", ".join(parts)


def _allowed(annotation: Any) -> str:
    """Give the values of a type in words."""
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        bounds = [bound for field in arguments[1:] for bound in getattr(field, "metadata", ())]
        return _limits(bounds) or _allowed(arguments[0])
    if origin is Literal:
        return ", ".join(f"`{value}`" for value in arguments)
    if origin in (Union, UnionType):
        kinds = dict.fromkeys(_allowed(kind) for kind in arguments if kind is not type(None))
        if _KINDS[float] in kinds:
            kinds.pop(_KINDS[int], None)
        return " or ".join(kinds)
    if origin in (tuple, list):
        return f"list ({_allowed(arguments[0])})"
    if annotation is dict or origin is dict or _is_section(annotation):
        return "section"
    return _KINDS[annotation]


def _is_section(annotation: Any) -> bool:
    return isinstance(annotation, type) and issubclass(annotation, JobSection)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return f"`{value}`"
    return f"{value:,}" if isinstance(value, int) else f"{value:g}"


def _escaped(text: str) -> str:
    return text.replace("<", "&lt;").replace("|", "\\|")


def _sentence(text: str) -> str:
    return text.strip().removesuffix(".")


def _table(header: list[str], rows: Iterable[list[str]]) -> str:
    head, *lines = (f"| {' | '.join(line)} |" for line in (header, *rows))
    return "\n".join([head, "|" + "---|" * len(header), *lines])


def with_names_of_plugins(stub: Path, hook: str) -> str:
    """Give a stub with the names that plugins add by a hook."""
    core, mark, rest = stub.read_text(encoding="utf-8").partition(_NAMES_OF_PLUGINS)
    root = FOLDER.parent / "pfdist"
    dots = "." * len(stub.relative_to(root).parts)
    names = [name for each in plugins().values() for name in getattr(each, hook)]
    lines = []
    for module, _, name in sorted(each.partition(":") for each in names):
        if (root.parent / f"{module.replace('.', '/')}.py").exists():
            lines.append(f"from {dots}{module.removeprefix('pfdist.')} import {name} as {name}\n")
    end = rest[rest.index("\n__all__") :]
    return f"{core}{mark}{''.join(lines)}{end}"


if __name__ == "__main__":
    for stub, hook in STUBS.items():
        stub.write_text(with_names_of_plugins(stub, hook), encoding="utf-8")
    for path in (FOLDER.parent / "README.md", *sorted(FOLDER.glob("*.md"))):
        path.write_text(with_tables(path.read_text(encoding="utf-8")), encoding="utf-8")
