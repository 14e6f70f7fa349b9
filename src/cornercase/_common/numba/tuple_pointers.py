"""References to named tuples of arrays: pointers that kernels pass to one another.

If a tuple were passed by value, each of its arrays would become seven or more arguments of each call, and compiling
would take much longer.
"""

# numba's extension API has no type hints.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc, untyped-decorator, attr-defined, override"

from __future__ import annotations

from typing import Any

from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils, imputils
from numba.core.datamodel import models
from numba.core.datamodel.registry import register_default
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, intrinsic, unbox


class Reference(types.Type):
    """numba type of a reference to a named tuple."""

    def __init__(self, table):
        self.table = table
        super().__init__(f"reference({table})")


@register_default(Reference)
class _ReferenceModel(models.PrimitiveModel):
    def __init__(self, manager, reference):
        super().__init__(manager, reference, manager.lookup(reference.table).get_value_type().as_pointer())


@unbox(Reference)
def _unbox_reference(reference, value, c):
    """Convert an address to a reference; numba requires this function, although Python passes no references."""
    return NativeValue(c.builder.bitcast(c.pyapi.long_as_voidptr(value), c.context.get_value_type(reference)))


def reference_type(value: Any) -> Any:
    """Return the numba type with which a kernel passes a value to another kernel.

    Named tuples are passed as a `Reference`. If `value` is a numba type, it is returned unchanged.
    """
    if isinstance(value, types.Type):
        return value
    kind = typeof(value)
    return Reference(kind) if isinstance(kind, types.BaseNamedTuple) else kind


@intrinsic
def reference_to(context, table):
    """Return a reference to a named tuple for use within a kernel; the fields of the tuple must not change afterwards.

    Named tuples in its fields are read as references, too. The tuple lives until the calling kernel returns, and is not
    reference-counted.
    """
    if not isinstance(table, types.BaseNamedTuple):
        return None

    def emit_reference(context, builder, signature, values):
        slot = cgutils.alloca_once(builder, values[0].type)
        builder.store(values[0], slot)
        # Hides the origin of the pointer from LLVM: later reads are declared constant, but the store above is not.
        function_type = ir.FunctionType(slot.type, [slot.type])
        return builder.asm(function_type, "", "=r,0,~{memory}", [slot], side_effect=True)

    return Reference(table)(table), emit_reference


@infer_getattr
class _ReferenceAttributes(AttributeTemplate):
    key = Reference

    def generic_resolve(self, reference, name):
        if name not in reference.table.fields:
            return None
        field = reference.table[reference.table.fields.index(name)]
        return Reference(field) if isinstance(field, types.BaseNamedTuple) else field


@imputils.lower_getattr_generic(Reference)
def _emit_field(context, builder, reference, value, name):
    index = reference.table.fields.index(name)
    pointer = cgutils.gep_inbounds(builder, value, 0, index)
    field = reference.table[index]
    if isinstance(field, types.BaseNamedTuple):
        return pointer
    return imputils.impl_ret_borrowed(context, builder, field, _load_constant(builder, pointer))


def _load_constant(builder, pointer):
    """Load a value that never changes; struct members are loaded one by one, so that unused ones can be left out."""
    kind = pointer.type.pointee
    if isinstance(kind, ir.LiteralStructType):
        value = ir.Constant(kind, ir.Undefined)
        for k in range(len(kind.elements)):
            member = _load_constant(builder, cgutils.gep_inbounds(builder, pointer, 0, k))
            value = builder.insert_value(value, member, k)
        return value
    if isinstance(kind, ir.ArrayType):
        value = ir.Constant(kind, ir.Undefined)
        for k in range(kind.count):
            member = _load_constant(builder, cgutils.gep_inbounds(builder, pointer, 0, k))
            value = builder.insert_value(value, member, k)
        return value
    loaded = builder.load(pointer)
    loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return loaded
