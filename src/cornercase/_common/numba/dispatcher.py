"""Compile a kernel together with all kernels that it calls: the whole code is optimized once.

numba alone would optimize each function, translate it to machine code and wrap it for calls from Python. It would
repeat this for all called functions, at each level of calls.
"""

# numba's internals have no type hints.
# mypy: disable-error-code="no-untyped-call, no-untyped-def, misc, attr-defined, assignment"

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import llvmlite.binding as llvm
import numpy as np
from numba.core import compiler, event, types, typing
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import CPUDispatcher

from cornercase._common.numba.interpret import can_interpret, interpret, must_interpret


class KernelDispatcher(CPUDispatcher):
    """Function that numba compiles (kernel); if another kernel calls it, both are compiled together."""

    def __init__(self, function, options, estimate_seconds=None):
        """Make a kernel; if `estimate_seconds` is given, Python may interpret the kernel until it is compiled.

        `estimate_seconds` gets the arguments of a call, and returns how many seconds Python would need for the call.
        """
        options = {"nopython": True, "nogil": True, "no_cfunc_wrapper": True, **options}
        super().__init__(function, targetoptions=options, pipeline_class=_Compiler)
        # By argument types: compiled to LLVM's intermediate representation, but not further.
        self._parts: dict[Any, Any] = {}
        self._estimate_seconds = estimate_seconds
        # Kinds of arguments for which no machine code was on disk.
        self._missing: set[Any] = set()
        # Types of arguments in calls at the address of the kernel; None if there are no such calls.
        self._late_kinds: Any = None

    @property
    def is_compiled(self):
        """True if this process has compiled or loaded the kernel alone, or compiled it as a part of another kernel."""
        return bool(self.overloads or self._parts)

    def has_machine_code(self, *args):
        """Return whether this process has machine code of the kernel, or the disk has code for the types of `args`.

        The disk is searched only once for the same types, because a search takes longer than a short interpreted call.
        Within `interpret_always`, the disk is not searched.
        """
        if self.overloads:
            return True
        if must_interpret():
            return False
        kinds = tuple(map(_argument_type_key, args))
        if kinds in self._missing:
            return False
        if self._cache.has_overload(tuple(map(self.typeof_pyval, args)), self.targetctx):
            return True
        self._missing.add(kinds)
        return False

    def compile(self, sig):
        """Compile the kernel for argument types, or load its machine code."""
        with _paused_garbage_collection():
            return super().compile(sig)

    def is_interpreted(self, *args):
        """Return whether a call with these arguments is interpreted."""
        estimate = self._estimate_seconds
        return estimate is not None and can_interpret(estimate(*args)) and not self.has_machine_code(*args)

    def compile_to_address(self, kinds, result):
        """Compile the kernel for argument types, or load its machine code; return its address."""
        self.check_address_types(kinds)
        self.compile(kinds)
        compiled = self.overloads[kinds]
        assert compiled.signature.return_type == result, (self, compiled.signature)
        return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)

    def check_address_types(self, kinds):
        """Raise `TypeError` if the argument types differ from an earlier call; code at an address has fixed types."""
        if self._late_kinds not in (None, kinds):
            raise TypeError(
                f"{self} is called with arguments of the types {kinds}, but earlier with the types {self._late_kinds}."
            )
        self._late_kinds = kinds

    def _compile_for_args(self, *args, **kws):
        # numba calls the function that is returned.
        if self.is_interpreted(*args):
            return partial(_interpret_call, self)
        return super()._compile_for_args(*args, **kws)

    def get_call_template(self, args, kws):
        """Return the signatures for a call from another kernel."""
        pysig, args = self._compiler.fold_argument_types(args, kws)
        # A constant argument needs no code of its own, because LLVM evaluates constants, too.
        args = tuple(map(types.unliteral, args))
        if args not in self._parts:
            with event.trigger_event("numba:compile", {"dispatcher": self, "args": args, "return_type": None}):
                self._parts[args] = self._compile_part(args)
        signatures = [part.signature for part in self._parts.values()]
        name = self.py_func.__name__
        return typing.make_concrete_template(f"CallTemplate({name})", name, signatures), pysig, args, {}

    def get_overload(self, args):
        """Return the key of the code that another kernel calls."""
        return self._parts[tuple(map(types.unliteral, args))].fndesc

    def _compile_part(self, args):
        flags = compiler.Flags()
        self.targetdescr.options.parse_as_flags(flags, self.targetoptions)
        flags.no_compile = flags.no_cpython_wrapper = True
        library = _CalledKernelLibrary(self.targetctx.codegen(), self.py_func.__qualname__)
        part = compiler.compile_extra(
            self.typingctx, self.targetctx, self.py_func, args, None, flags, self.locals, library, _Compiler
        )
        self.targetctx.insert_user_function(part.fndesc, part.fndesc, [library])
        return part


@contextmanager
def _paused_garbage_collection() -> Iterator[None]:
    """Pause garbage collection within the block: the compiler makes millions of objects and needs nearly all."""
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def _argument_type_key(value):
    """Return a key for the type of an argument, faster than numba; types of the elements of a tuple are ignored."""
    if isinstance(value, np.ndarray):
        return value.dtype, value.ndim, value.flags.c_contiguous
    return type(value)


def _interpret_call(kernel, *args):
    return interpret(kernel, args)


class _CalledKernelLibrary(JITCodeLibrary):
    """Intermediate code of a called kernel; it becomes machine code as a part of the calling kernel."""

    def finalize(self):
        self._raise_if_finalized()
        self._finalized = True

    def add_linking_library(self, library):
        library._ensure_finalized()
        self._linking_libraries.append(library)


class _KernelLibrary(JITCodeLibrary):
    """Code of a kernel together with the kernels that it calls, as one library."""

    def serialize_using_object_code(self):
        """Return name, kind and content in numba's format: machine code, and intermediate code with empty functions.

        The intermediate code is not needed, since no other kernel links this library.
        """
        names = _defined_names(self._final_module)
        definitions = "".join(f'define void @"{name}"() {{ ret void }}\n' for name in names)
        return self.name, "object", (self._get_compiled_object(), llvm.parse_assembly(definitions).as_bitcode())

    def finalize(self):
        own = set(_defined_names(self._final_module))
        libraries = list(_iter_linked_libraries(self._linking_libraries, set()))
        self._linking_libraries = []
        for library in libraries:
            self._reload_init.update(library._reload_init)
        modules = waiting = [library._get_module_for_linking() for library in libraries]
        # LLVM leaves out functions that nothing refers to yet; modules that are linked later may refer to them.
        while waiting:
            for module in waiting:
                self._final_module.link_in(module, preserve=True)
            lacking = {function.name for function in self._final_module.functions if function.is_declaration}
            waiting = [module for module in modules if not lacking.isdisjoint(_defined_names(module))]
        for function in self._final_module.functions:
            # No other library calls the function, so LLVM may inline it and leave it out.
            if not function.is_declaration and function.name not in own:
                function.linkage = "internal"
        super().finalize()


def _defined_names(module):
    return [function.name for function in module.functions if not function.is_declaration]


def _iter_linked_libraries(libraries, seen):
    for library in libraries:
        if library not in seen:
            seen.add(library)
            yield library
            if isinstance(library, _CalledKernelLibrary):
                yield from _iter_linked_libraries(library._linking_libraries, seen)


class _Compiler(compiler.Compiler):
    """numba's compiler for kernels."""

    def __init__(self, typing_context, target_context, library, *others):
        if library is None:
            library = _KernelLibrary(target_context.codegen(), "kernel")
            library.enable_object_caching()
        super().__init__(typing_context, target_context, library, *others)
