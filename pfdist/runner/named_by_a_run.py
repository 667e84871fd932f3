"""The models that a run's folder names: nothing is run before it was compared.

A run's folder never has a file run by itself. A model's file runs if its content is what the run
was made with and what the user has run on this machine before, or if the user names it.
"""

import os
import re
import stat
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

from pfdist.errors import StoreError
from pfdist.job.job import Job
from pfdist.meaning.chosen import ChosenModel, choose, chosen_from
from pfdist.meaning.known_models import is_known
from pfdist.models import ModelSource, is_in_folder
from pfdist.store import read_run

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
        Its run.json.
    instead : mapping of str to str
        What the user names in the place of "model" and "filter_model".
    say : callable
        Is told, in a line each, which files are run, before they are.
    remedy : str
        What the user can do to have a model run, with the part's name in the place of {part}.
    """

    run: Path
    about: Mapping[str, Any]
    instead: Mapping[str, str]
    say: Callable[[str], Any]
    remedy: str

    def __call__(
        self, part: str, name: str, folder: Path, parameters: Mapping[str, float]
    ) -> ChosenModel:
        """Choose the model of a part, "model" or "filter_model", as `pfdist.meaning.chosen.choose`.

        Raises
        ------
        StoreError
            The model's file is not what the run was made with, or the user has never run it.
        ModelError
            There is no such model, or it cannot be loaded.
        """
        if given := self.instead.get(part):
            self.say(f"runs the model {given}, as you name it")
            return choose(part, given, Path(), parameters)
        if len(name) > _LONGEST:
            raise StoreError(f"{self.run} names a model by {len(name):,} characters, not a file")
        if ".py:" not in name:  # of an installed package
            return choose(part, name, folder, parameters)
        source = self._source(part, name)
        self.say(
            f"runs the model file {source.path}, named by {self.run}: unchanged since that run, "
            "and you have run it before"
        )
        return chosen_from(source, parameters)

    def _source(self, part: str, name: str) -> ModelSource:
        """The model with the files of the run, if these are as they were and known."""
        file, _, attribute = name.rpartition(":")
        path, remedy = self._path(file), self.remedy.format(part=part)
        was = self._hashes(part, path.name, remedy)
        contents = {}
        for other, expected in was.items():
            beside = path.with_name(other)
            content = _content(beside)
            if content is None:
                raise StoreError(f"{self.run} names {beside}, which cannot be read; {remedy}")
            now = sha256(content).hexdigest()
            if now != expected:
                raise StoreError(
                    f"{beside} is not the file that {self.run} was made with ({expected[:8]} -> "
                    f"{now[:8]}), so nothing was run; {remedy}"
                )
            contents[other] = content
        main = contents.pop(path.name)
        source = ModelSource(name, str(path), attribute, "", main, tuple(sorted(contents.items())))
        if not is_known(source):
            raise StoreError(
                f"{path} is named by {self.run} alone, and you have not run it on this machine, so "
                f"nothing was run; look at it first; {remedy}"
            )
        return source

    def _path(self, file: str) -> Path:
        """Where a file is: relative to the first job's folder, which may be another one by now."""
        provenance = self.about.get("provenance")
        folder = provenance.get("folder") if isinstance(provenance, Mapping) else None
        folders = [Path(folder if isinstance(folder, str) else ""), Path(), self.run]
        paths = [(folder / file).absolute() for folder in folders]
        return next((path for path in paths if os.path.isfile(path)), paths[0])

    def _hashes(self, part: str, file: str, remedy: str) -> dict[str, str]:
        """SHA-256 of each of a model's files, by the file's name; checked, for it may be anything.

        Raises
        ------
        StoreError
            The run does not say them.
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
    """Give what chooses the models of a job that lies in a run's folder."""
    folder = job.path.parent
    remedy = "to have them run, copy job.toml to a folder of yours, and the files that it names"
    return NamedByRun(folder, read_run(folder)[0], {}, lambda line: None, remedy)


def files_named(job: Job) -> list[Path]:
    """Give the model files that a job names."""
    names = (job.model.name, job.model.filter.name)
    files = [name.rpartition(":")[0] for name in names if ".py:" in name]
    return [job.path.parent / file for file in dict.fromkeys(files)]


def _is_hash(name: Any, value: Any) -> bool:
    return is_in_folder(name) and isinstance(value, str) and _HASH.fullmatch(value) is not None


def _content(path: Path) -> bytes | None:
    """A plain file's content; None of what cannot be read, and of pipes and devices."""
    if not os.path.isfile(path):
        return None
    try:
        with open(path, "rb", opener=_without_waiting) as file:
            return file.read() if stat.S_ISREG(os.fstat(file.fileno()).st_mode) else None
    except OSError:
        return None


def _without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK)  # it may have become a pipe meanwhile
