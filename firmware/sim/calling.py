"""Calls of C functions from compiled code, by their addresses."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from numba import types
from numba.extending import intrinsic

if TYPE_CHECKING:
    from collections.abc import Callable


def _call(typing_context: Any, address: Any, arguments: Any) -> tuple[Any, Callable[..., Any]]:
    """Type and code of a call of the C function at an address with whole numbers; its int is what comes of it."""

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        from llvmlite import ir

        word = ir.IntType(64)
        function = ir.FunctionType(ir.IntType(32), [word] * len(arguments))
        target = builder.inttoptr(given[0], function.as_pointer())
        values = [builder.extract_value(given[1], i) for i in range(len(arguments))]
        return builder.sext(builder.call(target, values), word)

    return types.int64(types.int64, arguments), generate


call: Any = intrinsic(_call)
"""`call(address, arguments)`: call a C function with whole numbers, in compiled code; returns its int."""
