"""How the functions of the compiled form are compiled: LLVM sees all of them at once.

They get `Shared` as the address of a list of its arrays' addresses, and an array when they name it.
A tuple of all arrays would be some 300 arguments of each function, and took twice as long.
"""

import math
import types as python_types
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeVar, cast

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import from_dtype, njit, types
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_getattr_generic
from numba.np.arrayobj import make_array, populate_array

from mavproxy_fault.compiled.layout import SHAPES

# For type checkers a number of the compiled code is a number of Python.
i64 = cast(Callable[[Any], int], np.int64)

SHARED = types.CPointer(types.voidptr)
UNKNOWN_SIZE = 1 << 40  # nothing asks for it

Function = TypeVar("Function", bound=Callable[..., Any])


def kernel(function: Function) -> Function:
    """Let compiled code call a function; Python cannot."""
    options = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return cast(Function, njit(error_model="numpy", **options)(function))


@cache
def kernel_of(function: Callable[..., Any]) -> Callable[..., Any]:
    """Compile a plain function of another module, and those that it calls."""
    inner = {
        name: kernel_of(value)
        for name in function.__code__.co_names
        if isinstance(value := function.__globals__.get(name), python_types.FunctionType)
    }
    return kernel(python_types.FunctionType(function.__code__, {**function.__globals__, **inner}))


def choose(functions: Sequence[Callable[..., Any]], arguments: str) -> Callable[..., float]:
    """Compile a function that calls one of several by its number, its first argument."""
    names: dict[str, Any] = {f"f{n}": kernel_of(one) for n, one in enumerate(functions)}
    lines = [f"    if n == {n}: return float(f{n}({arguments}))" for n in range(len(functions))]
    # numba cannot call a function out of a list.
    exec("\n".join([f"def chosen(n, {arguments}):", *lines, "    return 0.0"]), names)
    return kernel(cast("Callable[..., float]", names["chosen"]))


@intrinsic  # type: ignore[untyped-decorator]
def draw(_: Any, function: Any, argument: Any) -> Any:
    """Call a C function of one address that returns a double, by its own address."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        kind = ir.FunctionType(ir.DoubleType(), [ir.IntType(64)])
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), [values[1]])

    return types.float64(types.int64, types.int64), code


@intrinsic  # type: ignore[untyped-decorator]
def call(_: Any, function: Any, one: Any, two: Any, three: Any) -> Any:
    """Call a C function of up to three words that returns one, by its address."""

    def code(__: Any, builder: Any, ___: Any, values: Any) -> Any:
        word = ir.IntType(64)
        kind = ir.FunctionType(word, [word] * 3)
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return types.int64(*[types.int64] * 4), code


@infer_getattr
class _Arrays(AttributeTemplate):  # type: ignore[misc]
    """The types of the arrays of `Shared`."""

    key = SHARED

    def generic_resolve(self, _: Any, name: str) -> Any:
        """The type of an array."""
        if name not in SHAPES:
            return None
        kind, *shape = SHAPES[name]
        return types.Array(from_dtype(np.dtype(kind)), len(shape), "C")


@lower_getattr_generic(SHARED)  # type: ignore[untyped-decorator]
def _array(context: Any, builder: Any, kind: Any, address: Any, name: str) -> Any:
    """An array of `Shared`."""
    array_type = _Arrays(context.typing_context).generic_resolve(kind, name)
    found = make_array(array_type)(context, builder)
    word, shape = context.get_value_type(types.intp), SHAPES[name][1:]
    place = builder.gep(address, [ir.Constant(word, [*SHAPES].index(name))])
    loaded = builder.load(place)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    sizes = [one if isinstance(one, int) else UNKNOWN_SIZE for one in shape]
    itemsize = np.dtype(SHAPES[name][0]).itemsize
    strides = [itemsize * math.prod(sizes[n + 1 :]) for n in range(len(sizes))]
    populate_array(
        found,
        data=builder.bitcast(loaded, found.data.type),
        shape=[ir.Constant(word, one) for one in sizes],
        strides=[ir.Constant(word, one) for one in strides],
        itemsize=ir.Constant(word, itemsize),
        meminfo=None,
    )
    return found._getvalue()
