"""Vectors of 64 bytes for numba: 8 double or 16 single precision numbers that undergo the same operations.

Numba leaves it to the compiler whether a loop becomes vector instructions. Compilers do not vectorize the recurrence of
dynamic time warping, so the vectors are explicit here. On machines with narrower registers the compiler splits them. No
operation reorders or fuses arithmetic: each lane has the same bits as scalar code.
"""

# Compiled functions have no static types.
# mypy: disable-error-code="import-untyped, untyped-decorator, no-untyped-call, misc, no-any-return"

from __future__ import annotations

from typing import Any

from llvmlite import ir
from llvmlite.binding import get_host_cpu_features
from numba.core import cgutils, types
from numba.extending import intrinsic, models, register_model

VECTOR_BYTES = 64


class Vector(types.Type):
    """Numba type of a vector of 64 bytes with elements of type `dtype`."""

    def __init__(self, dtype: types.Float) -> None:
        self.dtype = dtype
        self.lanes = VECTOR_BYTES * 8 // dtype.bitwidth
        super().__init__(name=f"Vector({dtype} x {self.lanes})")


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Vector) -> None:
        super().__init__(dmm, fe_type, _ir_type(fe_type))


def _ir_type(vector: Vector) -> ir.VectorType:
    scalar = ir.DoubleType() if vector.dtype.bitwidth == 64 else ir.FloatType()
    return ir.VectorType(scalar, vector.lanes)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, index: Any) -> Any:
    data = cgutils.create_struct_proxy(array_type)(context, builder, value=array).data
    return builder.gep(data, [index])


def _broadcast(builder: Any, scalar: Any, vector: ir.VectorType) -> Any:
    undefined = ir.Constant(vector, ir.Undefined)
    first_lane = builder.insert_element(undefined, scalar, ir.Constant(ir.IntType(32), 0))
    mask = ir.Constant(ir.VectorType(ir.IntType(32), vector.count), None)
    return builder.shuffle_vector(first_lane, undefined, mask)


def _call_llvm_intrinsic(builder: Any, name: str, value: Any) -> Any:
    suffix = f"v{value.type.count}{'f64' if value.type.element == ir.DoubleType() else 'f32'}"
    function_type = ir.FunctionType(value.type, [value.type])
    function = cgutils.get_or_insert_function(builder.module, function_type, f"llvm.{name}.{suffix}")
    return builder.call(function, [value])


@intrinsic
def load_vector(typingctx: Any, array: Any, index: Any) -> Any:
    """Load a vector from a contiguous one-dimensional array, from position `index` on."""
    vector = Vector(array.dtype)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, _ir_type(vector).as_pointer())
        return builder.load(pointer, align=array.dtype.bitwidth // 8)

    return vector(array, types.intp), codegen


@intrinsic
def store_vector(typingctx: Any, array: Any, index: Any, value: Any) -> Any:
    """Write a vector to an array, from position `index` on."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], args[0], args[1])
        pointer = builder.bitcast(pointer, args[2].type.as_pointer())
        builder.store(args[2], pointer, align=array.dtype.bitwidth // 8)
        return context.get_dummy_value()

    return types.none(array, types.intp, value), codegen


@intrinsic(prefer_literal=True)
def broadcast_point(typingctx: Any, array: Any, index: Any, dims: Any) -> Any:
    """Make a tuple of `dims` vectors, one for each coordinate of a point that begins at `index` of `array`.

    All lanes of a vector have the same value. `dims` is a constant.
    """
    vector = Vector(array.dtype)
    vectors = types.UniTuple(vector, dims.literal_value)

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], args[0], args[1])
        numbers = [
            builder.load(builder.gep(pointer, [context.get_constant(types.intp, d)])) for d in range(len(vectors))
        ]
        return context.make_tuple(
            builder, vectors, [_broadcast(builder, number, _ir_type(vector)) for number in numbers]
        )

    return vectors(array, types.intp, dims), codegen


@intrinsic
def sum_of_squares(typingctx: Any, point: Any, array: Any, index: Any) -> Any:
    """Return the squared distances of a point to the interleaved points that begin at `index`, one per lane."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        vector_type = _ir_type(point.dtype)
        pointer = builder.bitcast(
            _pointer(context, builder, signature.args[1], args[1], args[2]), vector_type.as_pointer()
        )
        total = None
        for d in range(len(point)):
            other = builder.load(
                builder.gep(pointer, [context.get_constant(types.intp, d)]), align=array.dtype.bitwidth // 8
            )
            difference = builder.fsub(builder.extract_value(args[0], d), other)
            square = builder.fmul(difference, difference)
            total = square if total is None else builder.fadd(total, square)
        return total

    return point.dtype(point, array, types.intp), codegen


def _make_binary_intrinsic(build: Any) -> Any:
    def typed(typingctx: Any, a: Any, b: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return build(builder, *args)

        return a(a, b), codegen

    return intrinsic(typed)


def _make_unary_intrinsic(build: Any) -> Any:
    def typed(typingctx: Any, a: Any) -> Any:
        def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return build(builder, args[0])

        return a(a), codegen

    return intrinsic(typed)


add = _make_binary_intrinsic(lambda builder, a, b: builder.fadd(a, b))
subtract = _make_binary_intrinsic(lambda builder, a, b: builder.fsub(a, b))
minimum = _make_binary_intrinsic(lambda builder, a, b: builder.select(builder.fcmp_ordered("<", a, b), a, b))


# In AVX-512 the integer minimum runs in parallel with additions, but the floating-point minimum competes with them. The
# bits of non-negative floats sort like integers.
_INTEGER_MINIMUM = bool(get_host_cpu_features().get("avx512f"))


@intrinsic
def nonnegative_minimum(typingctx: Any, a: Any, b: Any) -> Any:
    """Return the minimum of two vectors in each lane; their numbers are not negative, and may be infinite."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        a, b = args
        if not _INTEGER_MINIMUM:
            return builder.select(builder.fcmp_ordered("<", a, b), a, b)
        integer_vector = ir.VectorType(ir.IntType(VECTOR_BYTES * 8 // a.type.count), a.type.count)
        p, q = builder.bitcast(a, integer_vector), builder.bitcast(b, integer_vector)
        return builder.bitcast(builder.select(builder.icmp_signed("<", p, q), p, q), a.type)

    return a(a, b), codegen


absolute = _make_unary_intrinsic(lambda builder, a: _call_llvm_intrinsic(builder, "fabs", a))
root = _make_unary_intrinsic(lambda builder, a: _call_llvm_intrinsic(builder, "sqrt", a))


@intrinsic
def mask_outside_band(typingctx: Any, value: Any, shift: Any, below: Any, above: Any) -> Any:
    """Return `value` in the lanes in which ``-below <= shift <= above``, and infinity in the others."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        value, shift, below, above = args
        vector = value.type
        shift = _broadcast(builder, builder.sitofp(shift, vector.element), vector)
        inside = builder.and_(
            builder.fcmp_ordered(">=", shift, builder.fneg(below)), builder.fcmp_ordered("<=", shift, above)
        )
        infinity = ir.Constant(vector, [ir.Constant(vector.element, float("inf"))] * vector.count)
        return builder.select(inside, value, infinity)

    return value(value, types.intp, below, above), codegen
