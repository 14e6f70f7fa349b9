"""The command line: in this process, which has everything loaded, or in one of its own, as users start it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

from conftest import EXAMPLES
from cornercase.cli import main

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
SPACE = EXAMPLES / "x_intersection" / "x_intersection.space.xosc"

Ended = subprocess.CompletedProcess[str]


def cornercase(*arguments: object, cwd: Path | None = None) -> Ended:
    """Run a command here; a traceback of it is one of the test."""
    words = ["cornercase", *map(str, arguments)]
    said, told, before, loaded = io.StringIO(), io.StringIO(), sys.argv, set(sys.modules)
    folder = contextlib.chdir(cwd) if cwd is not None else contextlib.nullcontext()
    sys.argv = words
    code = 0
    try:
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told), folder:
            main()
    except SystemExit as ended:
        code = int(ended.code or 0)
    finally:
        sys.argv = before
        if cwd is not None:
            _forget_modules_of(cwd, set(sys.modules) - loaded)
    return Ended(words, code, said.getvalue(), told.getvalue())


def _forget_modules_of(folder: Path, names: set[str]) -> None:
    # A user's module of the same name in another test's folder would not be imported again.
    for name in names:
        file = getattr(sys.modules[name], "__file__", None)
        if file is not None and Path(file).resolve().is_relative_to(folder.resolve()):
            del sys.modules[name]


def process(*arguments: object, cwd: Path | None = None, environment: dict[str, str] | None = None) -> Ended:
    """Run a command in a process of its own, which takes a second longer."""
    command = [sys.executable, "-c", "from cornercase.cli import main; main()", *map(str, arguments)]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, timeout=300, env={**os.environ, **(environment or {})}
    )


# A line for each command as soon as it has ended, so that one which takes all of the process can be told.
_EACH = """
import json, sys
from command_line import cornercase

for words in json.load(sys.stdin):
    ended = cornercase(*words)
    print(json.dumps([ended.returncode, ended.stdout, ended.stderr]), flush=True)
"""


def process_of_all(
    commands: Iterable[Iterable[object]],
    cwd: Path | None = None,
    environment: dict[str, str] | None = None,
    limits: Callable[[], None] | None = None,
) -> list[Ended]:
    """Run commands one after the other in one other process; where that ends early, the rest is missing."""
    words = [list(map(str, command)) for command in commands]
    given = {**os.environ, **(environment or {})}
    # Tests find each other's modules by pytest's settings.
    given["PYTHONPATH"] = os.pathsep.join(filter(None, [given.get("PYTHONPATH"), *sys.path]))
    done = subprocess.run(
        [sys.executable, "-c", _EACH], input=json.dumps(words), capture_output=True, text=True, timeout=300,
        preexec_fn=limits, cwd=cwd, env=given,
    )  # fmt: skip
    ended = [Ended(one, *json.loads(line)) for one, line in zip(words, done.stdout.splitlines(), strict=False)]
    assert ended, done.stderr
    return ended
