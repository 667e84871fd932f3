"""Models that a run's folder names: no model file runs before it was compared.

A run's folder alone can never make a file run. A model file runs if the user names it. It also
runs if it is unchanged since the run, and the user has run it on this machine before.
"""

import os
import re
import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from typing import Any

from pfdist.errors import StoreError
from pfdist.job.job import Job
from pfdist.meaning.chosen import ChosenModel, choose, chosen_from
from pfdist.meaning.given import chosen_value, given_model
from pfdist.meaning.known_models import is_known
from pfdist.models import PYTHON, ModelSource, StateSpaceModel, is_in_folder, load_model
from pfdist.models.parameters import Parameter
from pfdist.store import read_run

Model = StateSpaceModel | str
"""A model as a user gives it: an object, or a name as in a job."""
_LONGEST = 4096  # characters of a path
_HASH = re.compile("[0-9a-f]{64}")


@dataclass(frozen=True)
class NamedByRun:
    """Chooses the models of a run's own job.

    Parameters
    ----------
    run : Path
        The run's folder.
    about : mapping
        Content of the run's run.json.
    instead : mapping of str to str, StateSpaceModel or ChosenModel
        Models that the user gives instead, for the parts "model" and "filter_model".
    say : callable
        Receives a line for each model file before the file is run.
    remedy : str
        Advice how to have a model run; {part} stands for the name of the part.
    """

    run: Path
    about: Mapping[str, Any]
    instead: Mapping[str, Model | ChosenModel]
    say: Callable[[str], Any]
    remedy: str

    def __call__(
        self, part: str, name: str, folder: Path, parameters: Mapping[str, Parameter]
    ) -> ChosenModel:
        """Choose the model of a part, "model" or "filter_model", as `pfdist.meaning.chosen.choose`.

        Raises
        ------
        StoreError
            The model file has changed since the run, or the user has never run it.
        ModelError
            There is no such model, or it cannot be loaded.
        """
        if given := self.instead.get(part):
            return self._given(part, name, given, parameters)
        if name.startswith(PYTHON):
            raise StoreError(
                f"{self.run} is of a model that was given as an object in Python ({name!r}): go on "
                "in Python with the object, as in pfdist.run(problem) and pfdist.why(run, "
                f"{part}={_variable(name)}), or ask with a file that holds it, {part} = "
                "FILE.py:OBJECT"
            )
        if len(name) > _LONGEST:
            raise StoreError(f"{self.run} names a model by {len(name):,} characters, not a file")
        if ".py:" not in name:  # a model of an installed package
            return choose(part, name, folder, parameters)
        source = self._source(part, name)
        self.say(
            f"runs the model file {source.path}, named by {self.run}: unchanged since that run, "
            "and you have run it before"
        )
        return chosen_from(source, parameters)

    def _given(
        self,
        part: str,
        name: str,
        given: Model | ChosenModel,
        parameters: Mapping[str, Parameter],
    ) -> ChosenModel:
        """The model that the user gives. A name gets the run's parameters, an object has its own.

        In the place of an object, a file's model is taken by value, so that both mean the same.
        """
        if isinstance(given, StateSpaceModel):
            if ".py:" in name and not name.startswith(PYTHON):
                return chosen_value(given)
            known = given_model(given)
            return known.chosen or choose(part, known.name, Path(), known.parameters)
        if isinstance(given, str):
            self.say(f"runs the model {given}, as you name it")
            chosen = given_model(load_model(given)).chosen if name.startswith(PYTHON) else None
            given = chosen or choose(part, given, Path(), parameters)
        return replace(given, parameters=dict(parameters))

    def _source(self, part: str, name: str) -> ModelSource:
        """Source of the model, if its files are unchanged since the run and known to the user."""
        file, _, attribute = name.rpartition(":")
        path, remedy = self._path(file), self.remedy.format(part=part)
        contents = {}
        for name_of_file, expected in self._hashes(part, path.name, remedy).items():
            beside = path.with_name(name_of_file)
            content = _content(beside)
            if content is None:
                raise StoreError(f"{self.run} names {beside}, which cannot be read; {remedy}")
            found = sha256(content).hexdigest()
            if found != expected:
                raise StoreError(
                    f"{beside} is not the file that {self.run} was made with ({expected[:8]} -> "
                    f"{found[:8]}), so nothing was run; {remedy}"
                )
            contents[name_of_file] = content
        main = contents.pop(path.name)
        source = ModelSource(name, str(path), attribute, "", main, tuple(sorted(contents.items())))
        if not is_known(source):
            raise StoreError(
                f"{path} is named by {self.run} alone, and you have not run it on this machine, so "
                f"nothing was run; look at it first; {remedy}"
            )
        return source

    def _path(self, file: str) -> Path:
        """Path of a model file: in the job's first folder, the current folder or the run's."""
        provenance = self.about.get("provenance")
        folder = provenance.get("folder") if isinstance(provenance, Mapping) else None
        folders = [Path(folder if isinstance(folder, str) else ""), Path(), self.run]
        paths = [(folder / file).absolute() for folder in folders]
        return next((path for path in paths if os.path.isfile(path)), paths[0])

    def _hashes(self, part: str, file: str, remedy: str) -> dict[str, str]:
        """SHA-256 of each file of a model, by the file's name; anything else is refused.

        Raises
        ------
        StoreError
            The run does not record the hashes.
        """
        provenance: Any = self.about.get("provenance")
        for key in ("files", part):
            provenance = provenance.get(key) if isinstance(provenance, Mapping) else None
        hashes = dict(provenance) if isinstance(provenance, Mapping) else {}
        if not (file in hashes and all(_is_hash(*pair) for pair in hashes.items())):
            raise StoreError(
                f"{self.run} does not say what its model's file {file} held, so nothing was run; "
                f"{remedy}"
            )
        return hashes


def of_a_runs_job(job: Job) -> NamedByRun:
    """The function that chooses the models of a job in a run's folder."""
    folder = job.path.parent
    remedy = "to have them run, copy job.toml to a folder of yours, and the files that it names"
    return NamedByRun(folder, read_run(folder)[0], {}, lambda line: None, remedy)


def files_named(job: Job) -> list[Path]:
    """Paths of the model files that a job names."""
    names = (job.model.name, job.model.filter.name)
    named = [name for name in names if ".py:" in name and not name.startswith(PYTHON)]
    files = [name.rpartition(":")[0] for name in named]
    return [job.path.parent / file for file in dict.fromkeys(files)]


def _variable(name: str) -> str:
    """A name for the model in an example of Python."""
    own = name.removeprefix(PYTHON)
    return own if own.isidentifier() else "model"


def _is_hash(name: Any, value: Any) -> bool:
    return is_in_folder(name) and isinstance(value, str) and _HASH.fullmatch(value) is not None


def _content(path: Path) -> bytes | None:
    """Content of a plain file; None for a file that cannot be read, a pipe or a device."""
    if not os.path.isfile(path):
        return None
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            return file.read() if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else None
    except OSError:
        return None


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # the file may have become a pipe in the meantime
