"""The model files that the user has run on this machine.

A run's folder may come from anywhere, and its author wrote both the model's name and the hashes in
it. So the folder is not trusted. When the user names a model's file and it is loaded, a hash of all
its files is kept beside the compiled code, in a folder that only the user can write. A command that
reads a run's folder may run the same content again, because the user has asked for it before.
"""

import contextlib
import hashlib

from pfdist.kernels.disk_cache import own_folder
from pfdist.models import ModelSource

_FOLDER = "models"


def remember(source: ModelSource) -> None:
    """Note that the user has run the files of a model. Installed packages need no note."""
    folder = own_folder()
    if source.package or folder is None:
        return
    with contextlib.suppress(OSError):  # without the note, the user must name the model again
        (folder / _FOLDER).mkdir(mode=0o700, exist_ok=True)
        (folder / _FOLDER / _name(source)).touch()


def is_known(source: ModelSource) -> bool:
    """Whether the user has run exactly these files on this machine."""
    folder = own_folder()
    return folder is not None and (folder / _FOLDER / _name(source)).is_file()


def _name(source: ModelSource) -> str:
    files = sorted(source.sha256.items())
    return hashlib.sha256(repr(files).encode("utf-8", "surrogateescape")).hexdigest()
