"""Each thing that is chosen by name is declared once."""

from importlib.metadata import EntryPoint

import pytest

from pfdist.common.registry import Registry
from pfdist.errors import PfdistError
from pfdist.pages.searches import curve_of
from pfdist.problem.methods import METHODS


def test_names_come_in_order_and_each_is_declared_once() -> None:
    registry = Registry[int]("pfdist.problem")
    for name in ("b", "c", "a"):
        registry.declare(name, 1)
    assert list(registry) == ["a", "b", "c"]
    with pytest.raises(ValueError, match="must be unique; 'a' is declared twice"):
        registry.declare("a", 2)


def test_an_addition_that_cannot_be_loaded_is_named_at_every_reading(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    entry_point = EntryPoint("mine", "nothing_of_this_name", "some.group")
    monkeypatch.setattr("pfdist.common.registry.entry_points", lambda group: [entry_point])
    registry = Registry[int]("pfdist.problem", "some.group")
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
