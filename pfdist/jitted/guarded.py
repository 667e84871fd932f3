"""The compiler that adds checks, so that a mistake is an error with a line and not a number.

`Guarded` is used like any of Numba's compilers: ``njit(function, pipeline_class=Guarded)``. It adds
a check in front of each statement that can go wrong:

- An index must lie in its array, and an array must fit the array that it is written to.
- An integer divisor must not be 0, and the result of integer arithmetic must fit 64 bits.
- A number that is converted to an integer type must fit that type.
- A called function must have been compiled with checks, too.

A function without such statements compiles to the same machine code as without checks.
"""

from typing import Any

from numba.core.compiler import Compiler
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.cpu_options import ParallelOptions
from numba.core.ir import Assign, Global
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NativeLowering
from numba.core.untyped_passes import MakeFunctionToJitFunction

from pfdist.jitted.admitted import MARK, is_checked
from pfdist.jitted.lowering import Context, Lowered


@register_pass(mutates_CFG=True, analysis_only=False)
class _Lowering(NativeLowering):  # type: ignore[misc]
    """Numba's last pass, with the checked lowering in place of its own."""

    _name = "lowering with checks"

    @property
    def lowering_class(self):
        return Lowered


@register_pass(mutates_CFG=False, analysis_only=False)
class _GuardClosures(FunctionPass):  # type: ignore[misc]
    """Compile functions that are defined inside a function with checks, too."""

    _name = "closures with checks"

    def __init__(self) -> None:
        super().__init__()

    def run_pass(self, state: Any) -> bool:
        for block in state.func_ir.blocks.values():
            for statement in block.body:
                value = getattr(statement, "value", None)
                if isinstance(statement, Assign) and isinstance(value, Global):
                    self._guard(value.value)
        return False

    def _guard(self, value: Any) -> None:
        if isinstance(value, CPUDispatcher) and not is_checked(value) and not value.overloads:
            value._compiler.pipeline_class = Guarded


class Guarded(Compiler):  # type: ignore[misc]
    """Numba's compiler with checks."""

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        super().__init__(*arguments, **keywords)
        context = self.state.targetctx
        context.__class__ = Context
        context.compiler = Guarded
        context.cached_internal_func = {}  # Numba's helpers, whose errors name this function
        context.enable_boundscheck = True
        self.state.flags.auto_parallel = ParallelOptions(False)  # parallel loops are not checked

    def define_pipelines(self) -> Any:
        """Give Numba's pipelines with the checked lowering."""
        pipelines = super().define_pipelines()
        for pipeline in pipelines:
            pipeline.passes = [
                (_Lowering if step is NativeLowering else step, what)
                for step, what in pipeline.passes
            ]
            pipeline.add_pass_after(_GuardClosures, MakeFunctionToJitFunction)
            pipeline.finalize()
        return pipelines


setattr(Guarded, MARK, True)
