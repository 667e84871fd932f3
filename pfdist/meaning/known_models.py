"""Model files that the user has run on this machine: a run's folder may have these run again.

A run's folder may come from anywhere, and whoever made it wrote both the model's name and the
hashes beside it. So the folder is not believed. When a user names a model's file and it is loaded,
a hash of all its files is kept beside the compiled code, in a folder that only the user can write.
To run the same content once more does nothing that the user has not asked for before.
"""

import contextlib
import hashlib

from pfdist.kernels.disk_cache import own_folder
from pfdist.models import ModelSource

_FOLDER = "models"


def remember(source: ModelSource) -> None:
    """Note that the user has had a model's files run; an installed package's need no note."""
    folder = own_folder()
    if source.package or folder is None:
        return
    with contextlib.suppress(OSError):  # a full disk costs the user an option of `why`, no more
        (folder / _FOLDER).mkdir(mode=0o700, exist_ok=True)
        (folder / _FOLDER / _name(source)).touch()


def is_known(source: ModelSource) -> bool:
    """Whether the user has had these very files run on this machine."""
    folder = own_folder()
    return folder is not None and (folder / _FOLDER / _name(source)).is_file()


def _name(source: ModelSource) -> str:
    files = sorted(source.sha256.items())
    return hashlib.sha256(repr(files).encode("utf-8", "surrogateescape")).hexdigest()
