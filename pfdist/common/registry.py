"""A registry: the objects of a kind that a user can choose by name."""

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from pfdist.errors import PfdistError

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Objects of a kind by their names, in alphabetical order.

    The modules of the package `package` declare themselves when they are imported. They are
    imported when the table is first read, and so are the entry points of the group `group`, if
    there is a group: installed packages have such entry points.
    """

    def __init__(self, package: str, group: str = "") -> None:
        self._package, self._group = package, group
        self._declared: dict[str, T] = {}
        self._complete = False

    def declare(self, name: str, value: T) -> None:
        """Add an object to the registry; raises ValueError if the name is taken."""
        if name in self._declared:
            raise ValueError(f"names in {self._package} must be unique; {name!r} is declared twice")
        self._declared[name] = value

    def __getitem__(self, name: str) -> T:
        return self._table()[name]

    def __iter__(self) -> Iterator[str]:
        return iter(sorted(self._table()))

    def __len__(self) -> int:
        return len(self._table())

    def _table(self) -> dict[str, T]:
        if not self._complete:
            self._complete = True  # first: a module may read the table while it is imported
            try:
                self._load()
            except BaseException:
                self._complete = False
                raise
        return self._declared

    def _load(self) -> None:
        folder = importlib.import_module(self._package).__path__
        for module in pkgutil.iter_modules(folder):
            importlib.import_module(f"{self._package}.{module.name}")
        for entry_point in entry_points(group=self._group) if self._group else ():
            try:
                entry_point.load()
            except Exception as error:
                raise PfdistError(
                    f"cannot load {entry_point.name!r}, which an installed package adds to "
                    f"{self._group} as {entry_point.value}: {type(error).__name__}: {error}"
                ) from error
