"""Each thing that is chosen by name is declared once."""

from importlib.metadata import EntryPoint

import pytest

from pfdist.common.registry import Registry
from pfdist.errors import PfdistError
from pfdist.plots.cost_curves import curve_of
from pfdist.search.methods import DEFAULT_METHOD, METHODS


def test_two_declarations_of_one_name_are_refused() -> None:
    registry = Registry[int]("pfdist.times")
    registry.declare("a", 1)
    with pytest.raises(ValueError, match="must be unique; 'a' is declared twice"):
        registry.declare("a", 2)


def test_names_come_in_order() -> None:
    registry = Registry[int]("pfdist.times")
    for name in ("b", "c", "a"):
        registry.declare(name, 1)
    assert list(registry) == ["a", "b", "c"]


def test_an_addition_that_cannot_be_loaded_is_named_at_every_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entry_point = EntryPoint("mine", "nothing_of_this_name", "some.group")
    monkeypatch.setattr("pfdist.common.registry.entry_points", lambda group: [entry_point])
    registry = Registry[int]("pfdist.times", "some.group")
    for _ in range(2):
        with pytest.raises(PfdistError, match=r"cannot load 'mine', which .* some\.group as n"):
            list(registry)


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
