"""Recorded programs, interpreted with `jax.numpy`: the twin of `evaluate_program`."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from typing import Any

import jax.numpy as jnp
from jax import lax

from pfdist.models.program import Program
from pfdist.models.tracing import MODES, Traced


@dataclass(frozen=True)
class CompiledFormula:
    """A traced formula that JAX compiles; two with the same programs are equal."""

    traced: Traced = field(compare=False)
    hash: str

    def __call__(self, t: Any, parameters: Mapping[str, Any], **groups: Sequence[Any]) -> list[Any]:
        """A value for each output; t may be traced by JAX, too."""
        traced, instants = self.traced, self.traced.instants
        at = jnp.clip(t - instants[0], 0, len(instants) - 1)
        row = 0 if traced.mode == MODES[0] else jnp.asarray(traced.row)[at]
        shape = jnp.broadcast_shapes(*map(jnp.shape, chain(*groups.values())))
        leaves = {"t": {None: jnp.asarray(t, float)}, "parameter": parameters, **groups}

        def values(program: Program) -> list[Any]:
            found = _Run(program, leaves, row, shape).outputs()
            return [jnp.broadcast_to(jnp.asarray(each, float), shape) for each in found]

        branches = [partial(values, each) for each in traced.programs]
        chosen = jnp.asarray(traced.which)[at] if len(branches) > 1 else 0
        found: list[Any] = lax.switch(chosen, branches)
        return found


@dataclass
class _Run:
    """One interpretation of a program, whose particles have a shape."""

    program: Program
    leaves: Mapping[str, Any]
    row: Any
    shape: tuple[int, ...]

    def outputs(self) -> list[Any]:
        values = dict[int, Any]()
        self._fill(values, range(len(self.program.operations)))
        return [values[each] for each in self.program.outputs]

    def _fill(self, values: dict[int, Any], numbers: Iterable[int], **step: Any) -> None:
        """Compute operations; `step` has the number and the states of a step of a loop."""
        operations, within = self.program.operations, -1
        for number in numbers:
            name, arguments, which = operations[number]
            if number <= within:
                continue
            if name == "repeat":
                within = self._loop(values, number)
            elif name == "state":
                values[number] = step["states"][which]
            elif name == "step":
                values[number] = step["number"].astype(float)
            elif name == "nth":
                given = jnp.broadcast_arrays(*(jnp.asarray(values[each]) for each in arguments[1:]))
                values[number] = jnp.stack(given)[step["number"]]
            else:
                values[number] = self._value(name, which, [values[each] for each in arguments])

    def _loop(self, values: dict[int, Any], begin: int) -> int:
        """Compute a loop; the number of its operation "again", which gets the last states."""
        operations = self.program.operations
        end = next(
            number for number, each in enumerate(operations)
            if each.name == "again" and each.arguments[0] == begin
        )  # fmt: skip
        count, *first = (values[each] for each in operations[begin].arguments)
        steps = jnp.where(count >= 1, jnp.minimum(count, operations[begin].which), 1)
        shape = jnp.broadcast_shapes(self.shape, *map(jnp.shape, first))

        def alike(given: Iterable[Any]) -> list[Any]:
            return [jnp.broadcast_to(jnp.asarray(each, float), shape) for each in given]

        def body(number: Any, states: list[Any]) -> list[Any]:
            inner = dict(values)
            self._fill(inner, range(begin + 1, end), number=number, states=states)
            return alike(inner[each] for each in operations[end].arguments[1:])

        values[end] = lax.fori_loop(0, jnp.int32(steps), body, alike(first))
        return end

    def _value(self, name: str, which: Any, given: list[Any]) -> Any:
        if name in self.leaves:
            return self.leaves[name][which]
        if name == "constant":
            return jnp.asarray(self.program.constants[:, which], float)[self.row]
        if name == "covariate":
            return jnp.asarray(self.leaves["parameter"][which])[jnp.int32(given[0])]
        if name == "take":
            table, (index,) = jnp.asarray(self.program.tables[which], float), given
            inside = (index >= 0) & (index < table.size)
            return jnp.where(inside, table[jnp.int32(jnp.where(inside, index, 0))], jnp.nan)
        if name == "final":
            return given[0][which]
        return jnp.where(given[0], 1.0, 0.0) if name == "float" else getattr(jnp, name)(*given)
