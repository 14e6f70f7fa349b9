"""The command line: in this process, which has everything loaded, or in one of its own, as users start it."""

from __future__ import annotations

import contextlib
import io
import json
import os
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from conftest import EXAMPLES
from cornercase import NoticeWarning
from cornercase.cli import main
from helpers.waiting import until

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
        # As in a process of its own, a notice is printed, each command sets its own filters, and none is an error.
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(told), folder, warnings.catch_warnings():
            warnings.simplefilter("default", NoticeWarning)
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


# Goes on until so many scenarios have ended, says so by a file, and waits to be ended itself.
_WAITING = """
import itertools, pathlib, signal, sys, time
from cornercase.cli import main
from cornercase.study._writer import StudyWriter

flag, count, sys.argv[1:] = pathlib.Path(sys.argv[1]), int(sys.argv[2]), sys.argv[3:]
number, finish = itertools.count(1), StudyWriter.record_result

def finish_and_wait(*given, **more):
    finish(*given, **more)
    if next(number) == count:
        flag.touch()
        time.sleep(600)

StudyWriter.record_result = finish_and_wait
# As a job in the background the process would inherit that the signal is ignored.
signal.signal(signal.SIGINT, signal.default_int_handler)
main()
"""


@contextlib.contextmanager
def waiting_after(count: int, flag: Path, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Run a search in a process of its own that waits after so many scenarios, for as long as it takes to end it."""
    words = [str(flag), str(count), *map(str, arguments)]
    running = subprocess.Popen(
        [sys.executable, "-c", _WAITING, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        until(lambda: flag.exists() or running.poll() is not None, 300.0)
        assert flag.exists(), running.communicate()[1]
        yield running
    finally:
        running.kill()
        running.communicate()


# A line for each command as soon as it has ended, so that one which takes all of the process can be told.
_EACH = """
import json, sys
from helpers.command_line import cornercase

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
