"""Sections of job files that plugins add."""

from collections.abc import Mapping, Sequence
from functools import cache
from pkgutil import resolve_name
from typing import Any, ClassVar, TypeVar, cast

from pydantic import create_model

from pfdist.common.plugins import hooked
from pfdist.common.section import JobSection

T = TypeVar("T", bound=type[JobSection])


class AddedSection(JobSection):
    """Base class of a section that a plugin adds; a job without it has None in its place."""

    title: ClassVar[str] = ""
    """The title of a report of a run with the section."""

    chapter: ClassVar[str] = ""
    """``module:function`` of the one section of its answer; none for those of other runs."""
    study: ClassVar[str] = ""
    """``module:class`` of the `pfdist.runner.study.Study` of a run; none for the usual one."""
    has_amounts: ClassVar[bool] = False
    """Whether there are sets of several numbers of measurements, or prices."""

    @property
    def amounts(self) -> Sequence[int]:
        """These numbers, or prices."""
        return ()

    def check(self, job: Any) -> None:
        """Raise a `ValueError` if a `pfdist.Job` does not go with the section."""


@cache
def added_sections() -> dict[str, type[AddedSection]]:
    """The sections by their keys."""
    return {key: resolve_name(name) for key, name in hooked("sections").items()}


def sections_of(job: Mapping[str, Any]) -> list[type[AddedSection]]:
    """The sections that the resolved job of a run has."""
    return [section for key, section in added_sections().items() if key in job]


def has_amounts(job: Mapping[str, Any]) -> bool:
    """Whether a run has sets of several numbers of measurements, or prices, by its resolved job."""
    return any(section.has_amounts for section in sections_of(job))


def with_added_sections(job: T) -> T:
    """A class of jobs whose last fields are the sections."""
    fields: Any = {key: (section | None, None) for key, section in added_sections().items()}
    kind: Any = create_model(
        job.__name__, __base__=job, __module__=job.__module__, __doc__=job.__doc__, **fields
    )
    return cast(T, kind)
