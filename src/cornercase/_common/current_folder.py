"""The current folder may be a stranger's: none of its modules is run, and no library takes its settings from there."""

from __future__ import annotations

import importlib
import os
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Final

# What libraries look for in the current folder, by the module that does so as it is loaded.
_SETTINGS: Final = {"numba.core.config": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
# The packages of which Python's way to import consists.
_IMPORTING: Final = ("importlib", "_frozen_importlib", "_frozen_importlib_external")


class _Shared:
    """A context that the first who asks for it enters and the last one leaves, in whatever thread."""

    def __init__(self, make: Callable[[], AbstractContextManager[None]]) -> None:
        self._make, self._lock, self._asked = make, threading.Lock(), 0

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if not self._asked:
                self._context = self._make()
                self._context.__enter__()
            self._asked += 1
        try:
            yield
        finally:
            with self._lock:
                self._asked -= 1
                if not self._asked:
                    self._context.__exit__(None, None, None)


@contextmanager
def _hidden_settings() -> Iterator[None]:
    path: Any = os.path
    exists = path.exists
    # Moving to another folder meanwhile would move all threads of a user's program.
    path.exists = lambda given: given not in _SETTINGS.values() and exists(given)
    try:
        yield
    finally:
        path.exists = exists


_HIDDEN: Final = _Shared(_hidden_settings)


class _Finder:
    """Finds modules as all others do, but has those loaded without the current folder that take settings from it."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        if name not in _SETTINGS:
            return None
        others = (one for one in sys.meta_path if one is not self)
        spec = next(filter(None, (one.find_spec(name, path, target) for one in others)), None)
        if spec is not None and spec.loader is not None:
            loader: Any = spec.loader
            loader.exec_module = _loading_without(loader.exec_module)
        return spec


def _loading_without(load: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def load_without(module: ModuleType) -> None:
        with _HIDDEN():
            load(module)
        _settle(module)

    return load_without


def _settle(module: ModuleType) -> None:
    """Have numba, which looks again whenever it compiles, look beside itself."""
    name = str(vars(module).get("_config_fname"))
    if name in _SETTINGS.values() and module.__file__ is not None:
        vars(module)["_config_fname"] = str(Path(module.__file__).with_name(name))


def take_no_settings() -> None:
    """Keep the libraries that this process loads from now on from taking settings from the current folder."""
    if not any(isinstance(one, _Finder) for one in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
        for name in _SETTINGS.keys() & sys.modules.keys():
            _settle(sys.modules[name])


class _Here:
    """Finds modules of the current folder, after all others: what a person has named there, and what that imports."""

    def __init__(self) -> None:
        self._folder = os.getcwd()
        # Top-level modules that were found so, by their names.
        self.found: set[str] = set()
        # Whether what a person has named is being imported; later only what was found here may import from here.
        self.is_open = True

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        if path is not None or not self._is_asked():
            return None
        spec = PathFinder.find_spec(name, [self._folder], target)
        if spec is not None:
            self.found.add(name)
        return spec

    def _is_asked(self) -> bool:
        """Whether this module imports it, or one that was found here; others also try what need not be there."""
        frame: FrameType | None = sys._getframe(2)
        while frame is not None and (name := _package_of(frame)) in _IMPORTING:
            frame = frame.f_back
        if frame is None:
            return False
        asks = frame.f_globals is globals() or name == "cloudpickle"
        return name in self.found or (self.is_open and asks)


def _package_of(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__")).partition(".")[0]


@contextmanager
def _found_here() -> Iterator[None]:
    finder = _Here()
    sys.meta_path.append(finder)
    try:
        yield
    finally:
        finder.is_open = False
        # What was found may import more as it runs.
        if not finder.found:
            sys.meta_path.remove(finder)


def import_here(name: str) -> ModuleType:
    """Import a module that a person has named, which may lie in the current folder; it hides no other one there.

    Parameters
    ----------
    name : str

    Returns
    -------
    module
    """
    with _found_here():
        return importlib.import_module(name)


def unpickle_here(content: bytes) -> Any:
    """Unpickle what a person has made, whose modules may lie in the current folder.

    Parameters
    ----------
    content : bytes
        Of a process that this one belongs to.

    Returns
    -------
    object
    """
    import pickle

    with _found_here():
        return pickle.loads(content)


@contextmanager
def _safe_starts() -> Iterator[None]:
    from multiprocessing import spawn, util

    parts: tuple[Any, Any] = spawn, util
    data, arguments = parts[0].get_preparation_data, parts[1]._args_from_interpreter_flags
    parts[0].get_preparation_data = lambda name: {**data(name), "sys_path": _path_of_children()}
    # Else Python itself puts the current folder first, as it gets what to run on its command line.
    parts[1]._args_from_interpreter_flags = lambda: [*arguments(), "-P"]
    try:
        yield
    finally:
        parts[0].get_preparation_data, parts[1]._args_from_interpreter_flags = data, arguments


_SAFE: Final = _Shared(_safe_starts)


def kept_from_children() -> AbstractContextManager[None]:
    """Keep the current folder off the path of what `multiprocessing` starts within the block, in any thread.

    Blocks may overlap.

    Returns
    -------
    context manager
    """
    return _SAFE()


def _main_folder() -> str | None:
    """Folder from which the program was started: that of a script, or that of the package of a module."""
    main = sys.modules.get("__main__")
    file, spec = getattr(main, "__file__", None), getattr(main, "__spec__", None)
    if file is None:
        return None
    above = 0 if spec is None else spec.name.count(".")
    return str(Path(os.path.realpath(file)).parents[above])


def _path_of_children() -> list[str]:
    here = os.path.realpath(os.getcwd())
    # A script that was started in its folder is loaded again by its children, with what lies beside it. Nobody else,
    # such as a notebook, needs the folder; an empty path stands for it, too.
    last = [one for one in sys.path if one and os.path.realpath(one) == here] if _main_folder() == here else []
    places = [one for one in sys.path if one and os.path.realpath(one) != here] + last
    package = str(Path(__file__).parents[2])
    return places if package in places else [*places, package]
