"""Names and units of components of x, y and z, and the suffixes of their columns."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from pfdist.errors import shown

_LONGEST_NAME, _LONGEST_UNIT = 40, 20  # characters
_TEXT = re.compile(r"([^\W\d_][\w -]*?) *(?:\[ *([^\[\] ][^\[\]]*)\])?")
_DEGREES = re.compile(r"(\b|_)deg(ree)?s?(\b|_)|[°º]", re.IGNORECASE)
_ALLOWED = (
    f"a letter, then letters, digits, _, - and spaces (at most {_LONGEST_NAME} characters), and on "
    f"request a unit in brackets (at most {_LONGEST_UNIT}), such as 'concentration [mg/l]'"
)


@dataclass(frozen=True)
class Component:
    """A component of x, y or z, as columns, figures and reports call it.

    >>> dose = named_component("Daily dose [mg/l]")
    >>> dose.suffix, dose.name, dose.unit, dose.label
    ('daily_dose', 'Daily dose', 'mg/l', 'Daily dose [mg/l]')
    """

    suffix: str  # end of the names of columns: the name with _ between words, or the number
    name: str = ""  # empty if the model does not give it
    unit: str = ""

    @property
    def label(self) -> str:
        """The name with the unit in brackets; empty without a name."""
        return f"{self.name} [{self.unit}]" if self.unit else self.name

    @property
    def unit_of_error(self) -> str:
        """The unit of an error in a sentence, where per cent would read as a share of the value."""
        return "percentage points" if self.unit == "%" else self.unit

    @property
    def is_in_degrees(self) -> bool:
        """Whether the name or the unit says degrees.

        >>> [named_component(each).is_in_degrees for each in ("lat [°]", "yaw_deg", "yaw [rad]")]
        [True, True, False]
        """
        return _DEGREES.search(self.label) is not None


def named_component(text: str) -> Component:
    """The component that a name such as ``concentration [mg/l]`` describes.

    Raises ValueError if the text is not such a name.
    """
    match = _TEXT.fullmatch(text) if isinstance(text, str) and text.isprintable() else None
    if not match or len(match[1]) > _LONGEST_NAME or len(match[2] or "") > _LONGEST_UNIT:
        raise ValueError(f"a name must be {_ALLOWED}, got {shown(text)}")
    name, unit = match[1], (match[2] or "").strip()
    return Component(re.sub(r"[\W_]+", "_", name.lower()).strip("_"), name, unit)


def named_components(names: Sequence[str], count: int) -> tuple[Component, ...]:
    """The components that these names describe; without names, numbered components.

    Raises ValueError if the number of names is wrong, or if two names give the same column.
    """
    if not names:
        return numbered_components(count)
    if len(names) != count:
        raise ValueError(f"must have a name for each of {count} components, got {len(names)} names")
    components = tuple(map(named_component, names))
    names_by_suffix = dict[str, str]()
    for component in components:
        if component.suffix in names_by_suffix:
            raise ValueError(
                f"must give different columns, got {names_by_suffix[component.suffix]!r} and "
                f"{component.name!r}, which both end with _{component.suffix}"
            )
        names_by_suffix[component.suffix] = component.name
    return components


def numbered_components(count: int) -> tuple[Component, ...]:
    """Components without names, whose columns end with 0, 1, ..."""
    return tuple(Component(str(number)) for number in range(count))
