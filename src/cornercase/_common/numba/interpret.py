"""Run kernels with Python's interpreter; results are the same as those of compiled kernels, to the last digit.

For a few scenarios this takes less time than compiling. `math` calls the same C library as compiled code; all other
operations are exact or replaced here.
"""

from __future__ import annotations

import ast
import ctypes
import math
import operator
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import CodeType, FunctionType, ModuleType, SimpleNamespace
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from numba.core.dispatcher import Dispatcher

from cornercase._common.numba import pointers, tuple_pointers

MAX_SECONDS: Final = 4.0
"""Longest time in s for which a process interprets kernels; compiling all kernels takes longer."""


class _InterpreterState:
    """Seconds for which this process has interpreted kernels, and settings of when kernels are interpreted."""

    spent = 0.0  # s
    is_stopped = False  # whether all kernels are compiled at their first call
    is_stopped_for_loops = False  # whether kernels with most of the work are compiled at their first call
    is_forced = False  # whether kernels are interpreted even if there is machine code


def can_interpret(seconds: float, *, is_loop: bool = False) -> bool:
    """Return whether this process may still interpret kernels, if the next call takes `seconds` s.

    `is_loop` is True for a kernel that does most of the work, such as the simulator's time loop.
    """
    if _InterpreterState.is_forced:
        return True
    is_stopped = _InterpreterState.is_stopped or (is_loop and _InterpreterState.is_stopped_for_loops)
    return not is_stopped and _InterpreterState.spent + seconds <= MAX_SECONDS


@contextmanager
def compile_at_once() -> Iterator[None]:
    """Within the block, compile kernels at their first call instead of interpreting them, because many calls follow."""
    before, _InterpreterState.is_stopped = _InterpreterState.is_stopped, True
    try:
        yield
    finally:
        _InterpreterState.is_stopped = before


@contextmanager
def compile_loops_at_once() -> Iterator[None]:
    """Within the block, compile kernels that do most of the work at their first call, because many calls follow."""
    before, _InterpreterState.is_stopped_for_loops = _InterpreterState.is_stopped_for_loops, True
    try:
        yield
    finally:
        _InterpreterState.is_stopped_for_loops = before


def must_compile_at_once() -> bool:
    """Return whether every kernel is compiled at its first call, as in `warm-up`; see `compile_at_once`."""
    return _InterpreterState.is_stopped


def must_interpret() -> bool:
    """Return whether kernels are interpreted even if machine code is on disk; see `interpret_always`."""
    return _InterpreterState.is_forced


@contextmanager
def interpret_always() -> Iterator[None]:
    """Within the block, run kernels as Python functions, so that a test can compare results with those of machine code.

    Kernels without `interpreted_seconds`, and those that this process has already compiled, still run as machine code.
    """
    before, _InterpreterState.is_forced = _InterpreterState.is_forced, True
    try:
        yield
    finally:
        _InterpreterState.is_forced = before


def interpret(kernel: Any, args: tuple[Any, ...]) -> Any:
    """Call a kernel as a Python function, and count the time that it takes."""
    start = time.thread_time()
    with np.errstate(all="ignore"):
        result = _interpreted_function(kernel.py_func)(*args)
    _InterpreterState.spent += time.thread_time() - start
    return result


@cache
def _interpreted_function(function: FunctionType) -> FunctionType:
    path = function.__code__.co_filename
    code = _compile_file_functions(path)[function.__name__, function.__code__.co_firstlineno]
    return FunctionType(
        code, _InterpretedGlobals.from_module(function.__globals__), function.__name__, function.__defaults__
    )


@cache
def _compile_file_functions(path: str) -> dict[tuple[str, int], CodeType]:
    """Compile all functions of a file with replaced operators; return their code, keyed by name and first line."""
    tree = ast.fix_missing_locations(_OperatorReplacer().visit(ast.parse(Path(path).read_text("utf-8"))))
    return {(code.co_name, code.co_firstlineno): code for code in _nested_codes(compile(tree, path, "exec"))}


def _nested_codes(code: CodeType) -> Iterator[CodeType]:
    yield code
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _nested_codes(constant)


class _OperatorReplacer(ast.NodeTransformer):
    """Syntax-tree transformer that replaces operators whose results differ in compiled code: divisions and powers."""

    functions: Final = {ast.Div: "_divide", ast.FloorDiv: "_floor_divide", ast.Mod: "_remainder", ast.Pow: "_power"}

    def visit_BinOp(self, node: ast.BinOp) -> ast.expr:
        """Replace a binary operator by a function call."""
        self.generic_visit(node)
        name = self.functions.get(type(node.op))
        if name is None:
            return node
        return ast.copy_location(ast.Call(ast.Name(name, ast.Load()), [node.left, node.right], []), node)

    def visit_AugAssign(self, node: ast.AugAssign) -> ast.AST:
        """Replace an operator such as ``/=`` if its target is a variable; array elements need no replacement."""
        self.generic_visit(node)
        if not isinstance(node.target, ast.Name):
            return node
        value = self.visit_BinOp(ast.BinOp(ast.Name(node.target.id, ast.Load()), node.op, node.value))
        return ast.copy_location(ast.Assign([node.target], value), node)


def _without_exceptions(compute: Callable[..., Any]) -> Callable[..., Any]:
    """Wrap a function of `math` so that it returns NaN or infinity, as compiled code does, instead of an exception."""

    def run(*args: Any) -> Any:
        try:
            return compute(*args)
        except OverflowError:
            return math.inf
        except ValueError:
            return -math.inf if compute is math.log and args[0] == 0 else math.nan

    return run


def _divide(a: Any, b: Any) -> Any:
    try:
        return a / b
    except ZeroDivisionError:
        return np.float64(a) / np.float64(b)


def _remainder(a: Any, b: Any) -> Any:
    try:
        return operator.mod(a, b)
    except ZeroDivisionError:
        # For integers, the result is 0, as in compiled code.
        return np.remainder(a, b)


def _floor_divide(a: Any, b: Any) -> Any:
    try:
        return a // b
    except ZeroDivisionError:
        # For integers, the result is 0, as in compiled code.
        return np.floor_divide(a, b)


def _power_of_floats(a: float, exponent: float) -> Any:
    if exponent == 0.5:
        return math.inf if a == -math.inf else _MATH.sqrt(a)
    try:
        return math.pow(a, exponent)
    except (ValueError, OverflowError):
        return np.power(np.float64(a), exponent)


def _power(a: Any, exponent: Any) -> Any:
    if not isinstance(exponent, int):
        return _power_of_floats(a, exponent)
    result, factor, remaining = 1, a, abs(exponent)
    while remaining:
        if remaining & 1:
            result = result * factor
        remaining >>= 1
        factor = factor * factor
    return 1.0 / result if exponent < 0 else result


def _convert_to_int64(value: Any) -> int:
    """Convert a value to an integer; a float beyond 64 bits gives the same integer as in compiled code."""
    try:
        result = int(value)
    except (ValueError, OverflowError):
        return int(np.float64(value).astype(np.int64))
    return result if -(2**63) <= result < 2**63 else int(np.float64(value).astype(np.int64))


# Python's own hypot rounds differently from the hypot of the C library.
_MATH: Final = SimpleNamespace(**vars(math))
for _name in ("acos", "asin", "atan", "atan2", "cos", "exp", "fmod", "log", "sin", "sqrt", "tan"):
    setattr(_MATH, _name, _without_exceptions(getattr(math, _name)))
_MATH.hypot = np.hypot
_MATH.floor, _MATH.ceil = lambda x: _convert_to_int64(np.floor(x)), lambda x: _convert_to_int64(np.ceil(x))


def _make_array_at_address(kind: Any) -> Callable[[int, int], npt.NDArray[Any]]:
    def array(address: int, count: int) -> npt.NDArray[Any]:
        return np.ctypeslib.as_array((kind * int(count)).from_address(int(address)))

    return array


def _call_without_address(kernel: Callable[..., Any], _: int, arguments: tuple[Any, ...]) -> Any:
    return kernel(*arguments)


_REPLACED: Final[dict[Any, Any]] = {
    math: _MATH,
    pointers.floats_at_address: _make_array_at_address(ctypes.c_double),
    pointers.ints_at_address: _make_array_at_address(ctypes.c_int64),
    pointers.bools_at_address: _make_array_at_address(ctypes.c_bool),
    pointers.call_for_int: _call_without_address,
    pointers.call_for_float: _call_without_address,
    pointers.call_for_bool: _call_without_address,
    tuple_pointers.reference_to: lambda table: table,
}


def _find_replacement(value: Any) -> Any:
    """Return the object that interpreted code uses in place of a global value."""
    if isinstance(value, Dispatcher):
        return _interpreted_function(value.py_func)
    if isinstance(value, ModuleType) and value.__name__.startswith("cornercase."):
        return _InterpretedModule(value)
    try:
        return _REPLACED.get(value, value)
    except TypeError:
        return value


class _InterpretedModule:
    """Stand-in for a module in interpreted code; kernels of the module are interpreted, too."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module

    def __getattr__(self, name: str) -> Any:
        value = _find_replacement(getattr(self._module, name))
        setattr(self, name, value)
        return value


_OPERATORS: Final = {
    "_divide": _divide,
    "_floor_divide": _floor_divide,
    "_remainder": _remainder,
    "_power": _power,
    "int": _convert_to_int64,
}


class _InterpretedGlobals(dict[str, Any]):
    """Global variables of a module for interpreted code."""

    modules: Final[dict[int, _InterpretedGlobals]] = {}

    @classmethod
    def from_module(cls, namespace: dict[str, Any]) -> _InterpretedGlobals:
        """Return the global variables for the functions of a module; they are made once per module."""
        made = cls.modules.get(id(namespace))
        if made is None:
            made = cls.modules[id(namespace)] = cls(_OPERATORS)
            made["__builtins__"] = namespace["__builtins__"]
            # Kernels may call one another in a circle of modules.
            for name, value in namespace.items():
                made.setdefault(name, _find_replacement(value))
        return made
