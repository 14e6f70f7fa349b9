"""Access to arrays and kernels by memory address, for use in kernels.

A kernel is compiled again for each number of array arguments. One table of addresses replaces all array arguments.
"""

# numba's extension API has no type hints.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc, untyped-decorator, attr-defined, call-arg"

from __future__ import annotations

from typing import Any

import numpy.typing as npt
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic


def memory_address(array: npt.NDArray[Any]) -> int:
    """Return the memory address of the first element of a C-contiguous array; the caller keeps the array alive."""
    assert array.flags.c_contiguous
    address: int = array.__array_interface__["data"][0]
    return address


def _array_intrinsic(context, address, count, dtype):
    """Return signature and code generator of an intrinsic that makes an array, shape (count,), at an address.

    The array is a view and not reference-counted; the caller keeps the memory alive.
    """
    array = types.Array(dtype, 1, "C")

    def emit_array(context, builder, signature, values):
        from numba.np.arrayobj import make_array, populate_array

        made = make_array(array)(context, builder)
        size = context.get_constant(types.intp, 1 if dtype is types.boolean else 8)
        data = builder.inttoptr(values[0], made.data.type)
        populate_array(made, data=data, shape=[values[1]], strides=[size], itemsize=size, meminfo=None)
        return made._getvalue()

    return array(types.int64, types.int64), emit_array


@intrinsic
def floats_at_address(context, address, count):
    """Return the memory at an address as an array of float64, shape (count,), without a copy."""
    return _array_intrinsic(context, address, count, types.float64)


@intrinsic
def ints_at_address(context, address, count):
    """Return the memory at an address as an array of int64, shape (count,), without a copy."""
    return _array_intrinsic(context, address, count, types.int64)


@intrinsic
def bools_at_address(context, address, count):
    """Return the memory at an address as an array of bool, shape (count,), without a copy."""
    return _array_intrinsic(context, address, count, types.boolean)


def _make_address_call(kernel, arguments, result):
    kinds = tuple(map(types.unliteral, arguments.types))
    kernel.dispatcher.check_address_types(kinds)

    def emit_call(context, builder, signature, values):
        with cgutils.if_unlikely(builder, cgutils.is_null(builder, values[1])):
            context.call_conv.return_user_exc(builder, RuntimeError, ("a kernel was called before it was compiled",))
        pointer = builder.inttoptr(values[1], context.call_conv.get_function_type(result, kinds).as_pointer())
        status, value = context.call_conv.call_function(
            builder, pointer, result, kinds, cgutils.unpack_tuple(builder, values[2], len(kinds))
        )
        with cgutils.if_unlikely(builder, status.is_error):
            context.call_conv.return_status_propagate(builder, status)
        return value

    return result(kernel, types.int64, types.BaseTuple.from_types(kinds)), emit_call


@intrinsic
def call_for_int(context, kernel, address, arguments):
    """Call the kernel at an address with a tuple of arguments, and return its integer result."""
    return _make_address_call(kernel, arguments, types.int64)


@intrinsic
def call_for_float(context, kernel, address, arguments):
    """Call the kernel at an address with a tuple of arguments, and return its float result."""
    return _make_address_call(kernel, arguments, types.float64)


@intrinsic
def call_for_bool(context, kernel, address, arguments):
    """Call the kernel at an address with a tuple of arguments, and return its Boolean result."""
    return _make_address_call(kernel, arguments, types.boolean)
