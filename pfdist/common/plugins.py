"""The hooks of the program, each a field of `Plugin`, with the module that asks for it.

The folder of each plugin of `pfdist.plugins`, and each entry point of the group ``pfdist.plugins``
of an installed package, has a `Plugin` of the name ``PLUGIN``. It names what it adds as
``module:object``, which is imported when it is needed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from pkgutil import resolve_name
from typing import Any, NamedTuple

from pfdist.errors import PfdistError

GROUP = "pfdist.plugins"
"""The package of the plugins that ship, and the group of entry points of others."""


class Command(NamedTuple):
    """A command of the command line.

    Parameters
    ----------
    function : str
        ``module:function``; it is imported when the command is called.
    sentence : str
        The first line of the function's docstring, for the list of commands.
    examples : dict of str to str
        Whole command lines of at most 78 characters, each with what it does. The help of the
        command ends with them, and a test runs them. The first is the one to begin with.
    resumes : bool
        Whether the same command, given again, resumes what was interrupted.
    """

    function: str
    sentence: str
    examples: dict[str, str]
    resumes: bool = False


class Name(NamedTuple):
    """Where the manual describes a name of the package itself.

    Parameters
    ----------
    page : str
        The page of the API: models, plan, runs or data.
    example : str
        A line of code.
    """

    page: str
    example: str


@dataclass(frozen=True, kw_only=True)
class Plugin:
    """All that a plugin adds to the program; a hook is a field.

    Parameters
    ----------
    commands : mapping
        Groups of the help, and the commands of each by name. `pfdist.cli.commands` asks.
    words : sequence of str
        Tables of `pfdist.cli.words.Word`, by the names of parameters. `pfdist.cli.words` asks.
    names : mapping of str to Name
        Objects with a name of the package itself, as `pfdist.rule`; ``docs/tables.py`` writes them
        into ``pfdist/__init__.pyi`` and the manual.
    plots : sequence of str
        Functions of `pfdist.plots`; ``docs/tables.py`` writes them into ``pfdist/pages/plots.pyi``.
    figures : sequence of str
        Modules that declare figures of a run. `pfdist.pages.figure` asks.
    capabilities : sequence of str
        Needs of jobs for the plugin: `pfdist.problem.needs.Capability`. That module asks.
    sections : mapping
        Sections of job files by their keys: forms of
        `pfdist.problem.added_sections.AddedSection`, for which that module asks. A key ``draws`` of
        one may grow in a run.
    parts : mapping
        Parts of the work of a run, in words, by their names. `pfdist.runner.parts` asks.
    later : mapping
        Work of a run after its comparison, by the section that asks for it:
        `pfdist.runner.later.LaterWork`. That module asks.
    summaries : mapping
        Functions that give values of `Run.as_json` from a run, by their keys.
        `pfdist.results.run` asks.
    answers : sequence of str
        Sections of the answer of a run, as `chapters`. `pfdist.questions.run_page` asks.
    sentences : sequence of str
        Sentences of this answer about its plan, of a `Subject`, which may be empty. That module
        asks.
    files : sequence of str
        Sections of files that are no jobs, marked by their first keys, for the JSON schema.
        `pfdist.problem.job_schema` asks.
    chapters : sequence of str
        Sections of the report of a run, functions of `pfdist.questions.subject.Subject` that may
        return None. `pfdist.questions.run_page` asks.
    engines : sequence of str
        Engines of ``filter.engine``: `pfdist.filters.engine.Engine`. `pfdist.filters.engines` asks.
    proposals : sequence of str
        Proposals of ``filter.proposal``: `pfdist.filters.proposal.Proposal`.
        `pfdist.filters.proposals` asks.
    looks : sequence of str
        Quick work of a plan beside its proof: `pfdist.runner.driver.QuickLook`. That module and
        `pfdist.questions.run` ask.
    others : mapping
        Hooks of other plugins, by the name of the plugin and of the hook.
    """

    commands: Mapping[str, Mapping[str, Command]] = field(default_factory=dict)
    words: Sequence[str] = ()
    names: Mapping[str, Name] = field(default_factory=dict)
    plots: Sequence[str] = ()
    figures: Sequence[str] = ()
    capabilities: Sequence[str] = ()
    sections: Mapping[str, str] = field(default_factory=dict)
    parts: Mapping[str, str] = field(default_factory=dict)
    later: Mapping[str, str] = field(default_factory=dict)
    summaries: Mapping[str, str] = field(default_factory=dict)
    answers: Sequence[str] = ()
    sentences: Sequence[str] = ()
    files: Sequence[str] = ()
    chapters: Sequence[str] = ()
    engines: Sequence[str] = ()
    proposals: Sequence[str] = ()
    looks: Sequence[str] = ()
    others: Mapping[str, str] = field(default_factory=dict)


@cache
def plugins() -> dict[str, Plugin]:
    """All plugins by name: those that ship, then those of installed packages.

    Raises
    ------
    PfdistError
        A plugin of an installed package cannot be loaded.
    """
    package = import_module(GROUP)
    found = {name: import_module(f"{GROUP}.{name}").PLUGIN for name in package.PLUGINS}
    for entry_point in entry_points(group=GROUP):
        try:
            found[entry_point.name] = entry_point.load()
        except Exception as error:
            raise cannot_load(entry_point.name, GROUP, entry_point.value, error) from error
    return found


def cannot_load(name: str, group: str, value: str, error: Exception) -> PfdistError:
    """The error of something that an installed package adds and that cannot be imported."""
    return PfdistError(
        f"cannot load {name!r}, which an installed package adds to {group} as {value}: "
        f"{type(error).__name__}: {error}"
    )


def added(hook: str) -> Iterator[Any]:
    """The objects that all plugins name in a hook, imported now."""
    for plugin in plugins().values():
        for name in getattr(plugin, hook):
            yield resolve_name(name)


def hooked(hook: str) -> dict[str, str]:
    """The names of objects that all plugins give for a hook, by their keys."""
    return {key: name for each in plugins().values() for key, name in getattr(each, hook).items()}


def import_modules(hook: str) -> None:
    """Import the modules that all plugins name in a hook, which declare what they add."""
    for plugin in plugins().values():
        for name in getattr(plugin, hook):
            import_module(name)


def asked(hook: str) -> Any:
    """The object that a plugin names for a hook of another one; None if no plugin does."""
    found = (each.others[hook] for each in plugins().values() if hook in each.others)
    name = next(found, None)
    return None if name is None else resolve_name(name)
