"""Runs one scenario after another by ScenarioRunner, each in a process of its own; a program that cornercase starts.

It runs in ScenarioRunner's own Python, 3.7 or later, so it must not import cornercase. It imports ScenarioRunner once.
Each scenario then runs in a fork of this process: nothing of it is left for the next one, neither in ScenarioRunner's
classes, py_trees' blackboard and Python's modules nor in CARLA's client, which is made in the fork. Where a process
cannot be forked safely, the program runs a single scenario itself and ends.

Requests come as lines of JSON on standard input, with the keys ``folder``, ``log``, ``drivers``, ``frame_rate`` in Hz,
and ``arguments`` of ScenarioRunner. For each, ``started PID`` goes out on standard output; and if that is a fork,
``ended STATUS``, negative for a signal. When all entities are there, and before the storyboard begins, the scenario's
process writes the number of the present frame into a file, and waits for a line on standard input: by then all entities
are recorded. When the storyboard has ended, it writes the number of the last frame, or the error with which it has
failed.
"""

from __future__ import annotations

import ctypes
import importlib
import json
import os
import signal
import sys
import threading
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

FIRST_FRAME_FILE, LAST_FRAME_FILE, FAILURE_FILE = "first_frame", "last_frame", "failure"
_THREADS_FOLDER = "/proc/self/task"
# Of Linux' `prctl`: this process becomes the parent of descendants whose own parents have ended.
_SET_CHILD_SUBREAPER = 36


def main() -> int:
    """Run scenarios until standard input ends; a fork returns its exit status."""
    # ScenarioRunner may print; then it must not be taken for an answer.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    n_threads = _count_threads_of_libraries()
    importlib.import_module("scenario_runner")
    can_fork = _can_fork(n_threads)
    if can_fork:
        _read_schema()
        _adopt_descendants()
    # Programs that an agent starts have nothing to read, else they would take the requests of later scenarios.
    requests = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    child = 0
    while True:
        line = _read_line(requests)
        if child:
            # Not before, so that until now the number means no other process.
            os.waitpid(child, 0)
        if not line:
            return 0
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork() if can_fork else 0
        if child == 0 and can_fork:
            _seed_again()
        if child == 0:
            if not can_fork:
                _answer(answers, "started", os.getpid())
            answers.close()
            return _run_scenario(json.loads(line), requests)
        _answer(answers, "started", child)
        state = os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
        assert state is not None
        _kill_children_but(child)
        _answer(answers, "ended", state.si_status if state.si_code == os.CLD_EXITED else -state.si_status)


def _count_threads_of_libraries() -> int:
    """Import the libraries whose threads survive a fork, as they start them again; return the number of threads."""
    for name in ("numpy", "scipy.linalg"):
        with suppress(ImportError):
            importlib.import_module(name)
    return _count_threads()


def _count_threads() -> int:
    return len(os.listdir(_THREADS_FOLDER)) if os.path.isdir(_THREADS_FOLDER) else 0


def _can_fork(n_threads: int) -> bool:
    """Whether a fork has all that this process has; other threads than those of libraries would be missing."""
    return sys.platform == "linux" and threading.active_count() == 1 and 0 < _count_threads() <= n_threads


def _read_schema() -> None:
    """Read the schema of OpenSCENARIO for all scenarios; ScenarioRunner does it for each, longer than all else it does.

    Validation changes nothing in a schema, and each fork has its own copy.
    """
    try:
        user = importlib.import_module("srunner.scenarioconfigs.openscenario_configuration")
    except ImportError:
        return
    path = os.path.join(os.path.dirname(os.path.abspath(str(user.__file__))), "../openscenario/OpenSCENARIO.xsd")
    library = vars(user).get("xmlschema")
    if library is None or not os.path.isfile(path):
        return
    schema = library.XMLSchema(path)

    def find_or_read(source: Any, *arguments: Any, **options: Any) -> Any:
        is_known = source == path and not arguments and not options
        return schema if is_known else library.XMLSchema(source, *arguments, **options)

    changed: dict[str, Any] = {**vars(library), "XMLSchema": find_or_read}
    user.xmlschema = SimpleNamespace(**changed)  # type: ignore[attr-defined]


def _adopt_descendants() -> None:
    """Have what a scenario's process has started become a child of this process when the scenario's process ends."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _kill_children_but(ended: int) -> None:
    """Kill what a scenario's process, which has ended, has started; it might go on to act on the server."""
    while True:
        try:
            with open(f"{_THREADS_FOLDER}/{os.getpid()}/children", encoding="ascii") as file:
                children = [int(number) for number in file.read().split() if int(number) != ended]
        except OSError:
            # Not each Linux tells its children.
            return
        if not children:
            return
        for child in children:
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)
                # Its own children become those of this process.
                os.waitpid(child, 0)


def _seed_again() -> None:
    """Give this process other random numbers than its siblings; Python does that for the module `random`."""
    if "numpy" in sys.modules:
        sys.modules["numpy"].random.seed()


def _run_scenario(request: dict[str, Any], requests: int) -> int:
    """Run ScenarioRunner in this process when the next line of `requests` comes, and return its exit status."""
    log = os.open(request["log"], os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(log, stream)
    os.close(log)
    os.chdir(request["folder"])
    # After the folder of this file and ScenarioRunner's.
    sys.path.insert(2, request["drivers"])
    folders = os.environ["PYTHONPATH"].split(os.pathsep)
    os.environ["PYTHONPATH"] = os.pathsep.join([folders[0], request["drivers"], *folders[1:]])
    sys.argv[1:] = request["arguments"]
    scenario_runner = importlib.import_module("scenario_runner")
    provider = importlib.import_module("srunner.scenariomanager.carla_data_provider").CarlaDataProvider
    manager_class = importlib.import_module("srunner.scenariomanager.scenario_manager").ScenarioManager
    run_scenario = manager_class.run_scenario

    def run_when_recorded(manager: Any) -> Any:
        world = provider.get_world()
        _write_frame(world, FIRST_FRAME_FILE)
        if not _read_line(requests):
            raise RuntimeError("cornercase has ended the run")
        try:
            result = run_scenario(manager)
        except BaseException as error:
            # An agent may have changed the folder.
            with suppress(OSError):
                _write(FAILURE_FILE, f"{type(error).__name__}: {error}")
            raise
        _write_frame(world, LAST_FRAME_FILE)
        return result

    manager_class.run_scenario = run_when_recorded
    # Before 0.9.16 there is no option for it.
    scenario_runner.ScenarioRunner.frame_rate = request["frame_rate"]
    return int(scenario_runner.main() or 0)


def _read_line(requests: int) -> str:
    """Return a line of an open file, empty at its end; read no further, since a fork reads the next one."""
    line = b""
    while not line.endswith(b"\n"):
        character = os.read(requests, 1)
        if not character:
            return ""
        line += character
    return line.decode("utf-8")


def _answer(answers: Any, word: str, number: int) -> None:
    answers.write(f"{word} {number}\n")
    answers.flush()


def _write_frame(world: Any, name: str) -> None:
    _write(name, str(world.get_snapshot().frame))


def _write(name: str, text: str) -> None:
    with open(name + ".part", "w", encoding="utf-8", errors="replace") as file:
        file.write(text)
    os.rename(name + ".part", name)


if __name__ == "__main__":
    sys.exit(main())
