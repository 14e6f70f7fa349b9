"""A folder in which a stranger has put a module for each name that a program may import, and files of settings."""

from __future__ import annotations

import contextlib
import ctypes
import os
import struct
import subprocess
import sys
import time
from collections.abc import Collection, Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

# What programs look for that need not be installed here: on other platforms, or where an extra is missing.
_ELSEWHERE = (
    "cmapi", "carla", "libsumo", "rtamt", "optuna", "pyarrow", "imageio_ffmpeg", "cupy", "numba_cuda", "cuda", "yaml",
    "bokeh", "uvloop", "httptools", "websockets", "wsproto", "dotenv", "setproctitle", "snappy", "lz4", "crick",
    "jupyter_server_proxy", "tbb", "mkl", "icc_rt", "intel_openmp", "java", "org", "gi", "wx", "PyQt5", "PyQt6",
    "PySide2", "PySide6", "colorama", "win32api", "pywintypes", "simplejson", "brotli", "cchardet", "chardet", "socks",
    "sitecustomize", "usercustomize", "conftest", "numexpr", "bottleneck", "odfpy", "xlrd", "pythran", "cython",
    "cryptography", "evil_entry",
)  # fmt: skip

_SETTINGS = (
    ".numba_config.yaml", "matplotlibrc", "dask.yaml", "distributed.yaml", ".dask/config.yaml", ".config/dask/dask.yaml",
    ".env", "pyproject.toml", "setup.cfg", "tox.ini", "pyvenv.cfg", "python._pth", "python311._pth", "evil.pth",
    "alembic.ini", "optuna.ini", "logging.conf", "config.yml", "config.yaml", "config.json", ".netrc", ".plotly/.config",
    ".plotly/.credentials", "proj.db", "proj.ini", "sumo.sumocfg", "sumo.cfg", "netconvert.netccfg", "osm.sumocfg",
    "ffmpeg.ffpreset", ".mplstyle", "default.mplstyle", "matplotlib/matplotlibrc", "openblas.cfg", "site.cfg",
    "pydistutils.cfg", "distutils.cfg", "uvicorn.json", "log.ini", ".pdbrc", ".pythonrc.py", "catalog",
    "OpenSCENARIO.xsd", "fonts.conf", "openssl.cnf", "magic", "mime.types",
)  # fmt: skip

_ENTRIES = "[{group}]\nwttc = evil_entry:Evil\nbuiltin = evil_entry:Evil\nevil = evil_entry:Evil\n"
_GROUPS = (
    *(f"cornercase.{one}" for one in ("metrics", "features", "optimizers", "simulators", "drivers")),
    "distributed.comm.backends", "dask.sizeof", "matplotlib.backend",
)  # fmt: skip

# A driver of one's own that lies there too.
_DRIVER = """import numpy as np
from cornercase.drivers import Driver


class Calm(Driver):
    def acceleration(self, situation):
        return np.full(len(situation.x), -1.0)
"""

# As a package index installs it: in a folder of programs, which comes first on its path.
_SCRIPT = """import sys
from cornercase.cli import main
if __name__ == "__main__":
    sys.exit(main())
"""

# As the system writes down what was done: opened, a folder, and that something is missing.
_OPENED, _FOLDER, _LOST = 0x20, 0x40000000, 0x4000


class HostileFolder:
    """The folder, and which of its modules were run.

    Parameters
    ----------
    place : Path
        A new folder, for this one and for what it needs beside it.
    but : collection of str
        Modules that are missing.
    """

    def __init__(self, place: Path, but: Collection[str] = ()) -> None:
        self.folder, self.notes, self._script = place / "hostile", place / "notes", place / "bin" / "command.py"
        for one in (self.folder, self.notes, self._script.parent):
            one.mkdir()
        self._script.write_text(_SCRIPT)
        names = {*sys.stdlib_module_names, *packages_distributions(), *_ELSEWHERE, "cornercase"}
        self._modules = {one for one in names if one.isidentifier()} - set(but)
        for name in self._modules:
            note = str(self.notes / name)
            (self.folder / f"{name}.py").write_text(f"open({note!r}, 'w').close()\n")
        for name in _SETTINGS:
            path = self.folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            # Nobody reads it without noticing.
            path.write_bytes(b"\xff\xfe nothing: [that, could be read\n")
        about = self.folder / "evil-1.0.dist-info"
        about.mkdir()
        (about / "METADATA").write_text("Metadata-Version: 2.1\nName: evil\nVersion: 1.0\n")
        (about / "entry_points.txt").write_text("".join(_ENTRIES.format(group=one) for one in _GROUPS))
        (self.folder / "mine.py").write_text(_DRIVER)

    @property
    def command(self) -> list[str]:
        return [sys.executable, str(self._script)]

    def cornercase(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Run the command in the folder, as users do."""
        return self.python(*self.command[1:], *words)

    def python(self, *words: object) -> subprocess.CompletedProcess[str]:
        """Run Python in the folder."""
        command = [sys.executable, *map(str, words)]
        return subprocess.run(
            command, cwd=self.folder, capture_output=True, text=True, timeout=300, stdin=subprocess.DEVNULL, check=False
        )

    def run(self) -> list[str]:
        """Names of the modules that were run."""
        return sorted(one.name for one in self.notes.iterdir())

    def forget(self) -> None:
        """Forget which were run."""
        for note in self.notes.iterdir():
            note.unlink()

    @contextlib.contextmanager
    def opened(self) -> Iterator[set[str]]:
        """Note which files of the stranger any process opens within the block; Linux alone tells, at its end."""
        found: set[str] = set()
        if not sys.platform.startswith("linux"):
            yield found
            return
        library = ctypes.CDLL(None, use_errno=True)
        watch = library.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        places: dict[int, Path] = {}
        try:
            for place in [self.folder, *(one for one in self.folder.rglob("*") if one.is_dir())]:
                number = library.inotify_add_watch(watch, os.fsencode(place), _OPENED)
                assert number >= 0, os.strerror(ctypes.get_errno())
                places[number] = place
            yield found
            time.sleep(0.05)
            names = {path.relative_to(self.folder).as_posix() for path in _files(watch, places)}
            found |= {one for one in names if self._is_hostile(one)}
        finally:
            os.close(watch)

    def _is_hostile(self, name: str) -> bool:
        return name in _SETTINGS or name.removesuffix(".py") in self._modules or name.startswith("evil-1.0.")


def _files(watch: int, places: dict[int, Path]) -> Iterator[Path]:
    with contextlib.suppress(BlockingIOError):
        while data := os.read(watch, 1 << 20):
            at = 0
            while at < len(data):
                number, mask, _, length = struct.unpack_from("iIII", data, at)
                assert not mask & _LOST
                # Folders are looked through for the files of scenarios.
                if not mask & _FOLDER:
                    yield places[number] / data[at + 16 : at + 16 + length].rstrip(b"\0").decode()
                at += 16 + length
