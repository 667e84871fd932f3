"""What can be chosen by name is declared once, by itself or by an installed package."""

import pytest

from pfdist.common.registry import Registry
from pfdist.plots.cost import curve_of
from pfdist.search.methods import DEFAULT_METHOD, METHODS


def test_two_declarations_of_one_name_are_refused() -> None:
    registry = Registry[int]("pfdist.times", "nobody.declares")
    registry.declare("a", 1)
    with pytest.raises(ValueError, match="must be unique; 'a' is declared twice"):
        registry.declare("a", 2)


def test_names_come_in_order() -> None:
    registry = Registry[int]("pfdist.times", "nobody.declares")
    for name in ("b", "c", "a"):
        registry.declare(name, 1)
    assert list(registry) == ["a", "b", "c"]


@pytest.mark.parametrize("name", METHODS)
def test_a_search_method_declares_all_that_is_made_from_it(name: str) -> None:
    method = METHODS[name]
    section = method.section()
    assert (section.method, section.name) == (name, name)
    assert method.description.endswith(".")
    assert callable(curve_of(name))
    assert set(section.settings) <= set(method.section.model_fields)


def test_the_default_is_one_of_them() -> None:
    assert DEFAULT_METHOD in METHODS
