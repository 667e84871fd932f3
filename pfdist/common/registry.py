"""A registry: the objects of a kind that a user can choose by name."""

import importlib
import pkgutil
from collections.abc import Iterator, Mapping
from importlib.metadata import entry_points
from typing import Generic, TypeVar

from pfdist.common.plugins import cannot_load, import_modules

T = TypeVar("T")


class Registry(Mapping[str, T], Generic[T]):
    """Objects of a kind by their names, in alphabetical order.

    The modules of the package `package` declare themselves when they are imported. They are
    imported when the table is first read; so are the modules that plugins name in the hook `hook`,
    and the entry points of the group `group` that installed packages have.
    """

    def __init__(self, package: str, group: str = "", hook: str = "") -> None:
        self._package, self._group, self._hook = package, group, hook
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
        if self._hook:
            import_modules(self._hook)
        for entry_point in entry_points(group=self._group) if self._group else ():
            try:
                entry_point.load()
            except Exception as error:
                named = entry_point.name, self._group, entry_point.value
                raise cannot_load(*named, error) from error
