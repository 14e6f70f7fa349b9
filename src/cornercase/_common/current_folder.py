"""Protection against files in the current folder: modules are imported only on request, settings files are ignored."""

from __future__ import annotations

import importlib
import os
import site
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import FrameType, ModuleType
from typing import Any, Final

# Settings file that a library looks for in the current folder, by the module that loads it.
_SETTINGS_FILES: Final = {"numba.core.config": ".numba_config.yaml", "matplotlib": "matplotlibrc"}
# Packages that implement Python's import system.
_IMPORT_MACHINERY: Final = ("importlib", "_frozen_importlib", "_frozen_importlib_external")


class _SharedContext:
    """A context manager that threads share: the first user enters it, and the last user exits it."""

    def __init__(self, factory: Callable[[], AbstractContextManager[None]]) -> None:
        self._factory, self._lock, self._users = factory, threading.Lock(), 0

    @contextmanager
    def __call__(self) -> Iterator[None]:
        with self._lock:
            if not self._users:
                self._context = self._factory()
                self._context.__enter__()
            self._users += 1
        try:
            yield
        finally:
            with self._lock:
                self._users -= 1
                if not self._users:
                    self._context.__exit__(None, None, None)


@contextmanager
def _hide_settings_files() -> Iterator[None]:
    path: Any = os.path
    exists = path.exists
    # Changing the working directory would affect all threads of a user's program.
    path.exists = lambda given: given not in _SETTINGS_FILES.values() and exists(given)
    try:
        yield
    finally:
        path.exists = exists


_hide_settings: Final = _SharedContext(_hide_settings_files)


class _SettingsHidingFinder:
    """Import hook that hides settings files in the current folder from the libraries that look for them there."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        if name not in _SETTINGS_FILES:
            return None
        other_finders = (finder for finder in sys.meta_path if finder is not self)
        spec = next(filter(None, (finder.find_spec(name, path, target) for finder in other_finders)), None)
        if spec is not None and spec.loader is not None:
            loader: Any = spec.loader
            loader.exec_module = _load_without_settings(loader.exec_module)
        return spec


def _load_without_settings(load: Callable[[ModuleType], None]) -> Callable[[ModuleType], None]:
    def load_hidden(module: ModuleType) -> None:
        with _hide_settings():
            load(module)
        _redirect_settings(module)

    return load_hidden


def _redirect_settings(module: ModuleType) -> None:
    """Make numba, which reads its settings file at each compilation, read the file in numba's own folder."""
    name = str(vars(module).get("_config_fname"))
    if name in _SETTINGS_FILES.values() and module.__file__ is not None:
        vars(module)["_config_fname"] = str(Path(module.__file__).with_name(name))


def ignore_settings_of_current_folder() -> None:
    """Keep libraries that are imported after this call from reading settings in the current folder."""
    if not any(isinstance(finder, _SettingsHidingFinder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _SettingsHidingFinder())
        for name in _SETTINGS_FILES.keys() & sys.modules.keys():
            _redirect_settings(sys.modules[name])


class _CurrentFolderFinder:
    """Import hook that finds modules in the current folder; Python asks it after all other hooks.

    It finds only the module that the user named, and the modules that this module imports.
    """

    def __init__(self) -> None:
        self._folder = os.getcwd()
        # Names of the top-level modules that were found here.
        self.imported_names: set[str] = set()
        # True while the named module is being imported; afterwards, only modules found here may import from here.
        self.is_open = True

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None, /
    ) -> ModuleSpec | None:
        if path is not None or not self._is_importer_trusted():
            return None
        spec = PathFinder.find_spec(name, [self._folder], target)
        if spec is not None:
            self.imported_names.add(name)
        return spec

    def _is_importer_trusted(self) -> bool:
        """Return whether the import was requested by the user, or by a module from the current folder.

        If another package tries an optional import meanwhile, this import must not find a module of the current folder.
        """
        frame: FrameType | None = sys._getframe(2)
        while frame is not None and (name := _top_package(frame)) in _IMPORT_MACHINERY:
            frame = frame.f_back
        if frame is None:
            return False
        asks = frame.f_globals is globals() or name == "cloudpickle"
        return name in self.imported_names or (self.is_open and asks)


def _top_package(frame: FrameType) -> str:
    return str(frame.f_globals.get("__name__")).partition(".")[0]


@contextmanager
def _import_from_current_folder() -> Iterator[None]:
    finder = _CurrentFolderFinder()
    sys.meta_path.append(finder)
    try:
        yield
    finally:
        finder.is_open = False
        # Modules found here may import more while they run.
        if not finder.imported_names:
            sys.meta_path.remove(finder)


def import_from_current_folder(name: str) -> ModuleType:
    """Import a module that the user named; it may be in the current folder.

    A module of the same name in another folder of the search path takes precedence.
    """
    with _import_from_current_folder():
        return importlib.import_module(name)


def unpickle_with_current_folder(content: bytes) -> Any:
    """Unpickle bytes from another process of this program; needed modules may be in the current folder."""
    import pickle

    with _import_from_current_folder():
        return pickle.loads(content)


@contextmanager
def _isolate_spawned_children() -> Iterator[None]:
    from multiprocessing import spawn, util

    parts: tuple[Any, Any] = spawn, util
    data, arguments = parts[0].get_preparation_data, parts[1]._args_from_interpreter_flags
    parts[0].get_preparation_data = lambda name: _isolate_preparation_data(data(name))
    # Without -P, Python puts the current folder first, as its code is given on the command line.
    parts[1]._args_from_interpreter_flags = lambda: [*arguments(), "-P"]
    try:
        yield
    finally:
        parts[0].get_preparation_data, parts[1]._args_from_interpreter_flags = data, arguments


def _isolate_preparation_data(data: dict[str, Any]) -> dict[str, Any]:
    """Return the data with which `multiprocessing` starts a child; leave out the user's script.

    The `sys.path` of the child is as described in `isolate_children`.
    """
    without_script = {name: value for name, value in data.items() if not name.startswith("init_main")}
    return {**without_script, "sys_path": _child_sys_path()}


_safe_child_start: Final = _SharedContext(_isolate_spawned_children)


def isolate_children() -> AbstractContextManager[None]:
    """Within the block, start child processes that neither run the main script nor import from the current folder.

    This applies to `multiprocessing`. A script then needs no ``if __name__ == "__main__"``, and objects that the script
    defines are sent by value. The current folder is not on the `sys.path` of the children, unless it contains the
    script, or PYTHONPATH or an installed package names it. Blocks may overlap.
    """
    return _safe_child_start()


def _main_folder() -> str | None:
    """Return the folder that the program was started from, or None in an interactive session.

    It is the folder of a script, or the folder that contains the top package of a module started with ``python -m``.
    """
    main = sys.modules.get("__main__")
    file, spec = getattr(main, "__file__", None), getattr(main, "__spec__", None)
    if file is None:
        return None
    above = 0 if spec is None else spec.name.count(".")
    return str(Path(os.path.realpath(file)).parents[above])


def _child_sys_path() -> list[str]:
    current = os.path.realpath(os.getcwd())
    # Objects of the main script may need its neighbours if it was started from its own folder. Other programs, such as
    # a notebook, do not need the folder; an empty path stands for it, too.
    own_folder = (
        [entry for entry in sys.path if entry and os.path.realpath(entry) == current]
        if _main_folder() == current
        else []
    )
    if current in _list_declared_import_folders():
        entries = [entry for entry in sys.path if entry]
    else:
        entries = [entry for entry in sys.path if entry and os.path.realpath(entry) != current] + own_folder
    package = str(Path(__file__).parents[2])
    return entries if package in entries else [*entries, package]


def _list_declared_import_folders() -> set[str]:
    """Return the folders named by PYTHONPATH or by a .pth file of an installed package, such as an editable package."""
    names = [] if sys.flags.ignore_environment else os.environ.get("PYTHONPATH", "").split(os.pathsep)
    for installed in (*site.getsitepackages(), *((site.getusersitepackages(),) if site.ENABLE_USER_SITE else ())):
        for file in Path(installed).glob("*.pth"):
            # Python skips what it cannot read, too.
            with suppress(OSError, ValueError):
                names += [
                    os.path.join(installed, line)
                    for line in file.read_text(encoding="utf-8").splitlines()
                    if line.strip()
                ]
    # An empty name in PYTHONPATH is mostly a mistake; it would stand for the current folder.
    return {os.path.realpath(name) for name in names if name}
