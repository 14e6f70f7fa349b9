"""Program that runs scenarios by ScenarioRunner one after another, each in a process of its own.

cornercase starts this program in ScenarioRunner's own Python (3.7 or later), so it must not import cornercase. It
imports ScenarioRunner once. Each scenario then runs in a fork of the program, so that nothing of a scenario is left for
the next one: neither in ScenarioRunner's classes, py_trees' blackboard and Python's modules nor in CARLA's client,
which is made in the fork. If the program cannot fork safely, it runs a single scenario itself and ends.

Requests are lines of JSON on standard input, with the keys ``folder``, ``log``, ``drivers``, ``frame_rate`` (in Hz) and
``arguments`` (of ScenarioRunner). For each request, the program writes ``started PID`` to standard output. If the
scenario runs in a fork, it also writes ``ended STATUS`` at the end, with a negative status for a signal.

When all entities exist, the scenario's process writes the number of the present frame into a file. It begins the
storyboard when a line comes on standard input, so that cornercase can record all entities from the start. When the
storyboard has ended, it writes the number of the last frame, or the error with which the storyboard has failed, into
another file.
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
# Option of Linux' `prctl`: this process becomes the parent of descendants whose own parents have ended.
_SET_CHILD_SUBREAPER = 36


def main() -> int:
    """Run the requested scenarios until standard input ends; a fork returns the exit status of its scenario."""
    # What ScenarioRunner prints must not be taken for an answer.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    n_threads = _import_threaded_libraries()
    importlib.import_module("scenario_runner")
    can_fork = _can_fork(n_threads)
    if can_fork:
        _preload_schema()
        _adopt_descendants()
    # Programs that an agent starts get an empty input, or they would read the requests of later scenarios.
    requests = os.dup(0)
    nothing = os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    child = 0
    while True:
        line = _read_line(requests)
        if child:
            # Not earlier: until then, no other process can get the same number.
            os.waitpid(child, 0)
        if not line:
            return 0
        sys.stdout.flush()
        sys.stderr.flush()
        child = os.fork() if can_fork else 0
        if child == 0 and can_fork:
            _reseed_numpy()
        if child == 0:
            if not can_fork:
                _answer(answers, "started", os.getpid())
            answers.close()
            return _run_scenario(json.loads(line), requests)
        _answer(answers, "started", child)
        state = os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
        assert state is not None
        _kill_leftover_processes(child)
        _answer(answers, "ended", state.si_status if state.si_code == os.CLD_EXITED else -state.si_status)


def _import_threaded_libraries() -> int:
    """Import libraries that start their threads again after a fork; return this process's number of threads."""
    for name in ("numpy", "scipy.linalg"):
        with suppress(ImportError):
            importlib.import_module(name)
    return _count_threads()


def _count_threads() -> int:
    return len(os.listdir(_THREADS_FOLDER)) if os.path.isdir(_THREADS_FOLDER) else 0


def _can_fork(n_threads: int) -> bool:
    """Return whether this process can fork safely: it has at most `n_threads` threads, its own and those of libraries.

    All other threads would be missing in the fork.
    """
    return sys.platform == "linux" and threading.active_count() == 1 and 0 < _count_threads() <= n_threads


def _preload_schema() -> None:
    """Read OpenSCENARIO's schema once for all scenarios.

    ScenarioRunner would read it for each scenario, which takes longer than everything else that it does at the start.
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
    """Make this process the new parent of processes that are left when the process of a scenario ends."""
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).prctl(_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def _kill_leftover_processes(ended: int) -> None:
    """Kill the processes that a scenario has left, since they might go on to act on the server.

    `ended` is the number of the scenario's own process, which has ended already.
    """
    while True:
        try:
            with open(f"{_THREADS_FOLDER}/{os.getpid()}/children", encoding="ascii") as file:
                children = [int(number) for number in file.read().split() if int(number) != ended]
        except OSError:
            # Some Linux kernels do not list the children of a process.
            return
        if not children:
            return
        for child in children:
            with suppress(OSError):
                os.kill(child, signal.SIGKILL)
                # Its own children become those of this process.
                os.waitpid(child, 0)


def _reseed_numpy() -> None:
    """Seed NumPy again, so that the random numbers of this fork differ from those of other forks.

    Python itself does this for the module `random`.
    """
    if "numpy" in sys.modules:
        sys.modules["numpy"].random.seed()


def _run_scenario(request: dict[str, Any], requests: int) -> int:
    """Run ScenarioRunner in this process, and return its exit status.

    The storyboard begins when the next line of `requests` comes.
    """
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
                _write_atomically(FAILURE_FILE, f"{type(error).__name__}: {error}")
            raise
        _write_frame(world, LAST_FRAME_FILE)
        return result

    manager_class.run_scenario = run_when_recorded
    # ScenarioRunner before 0.9.16 has no option for the frame rate.
    scenario_runner.ScenarioRunner.frame_rate = request["frame_rate"]
    return int(scenario_runner.main() or 0)


def _read_line(requests: int) -> str:
    """Return the next line of an open file, empty at the end of the file.

    Nothing after this line is read, since a fork reads the next line itself.
    """
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
    _write_atomically(name, str(world.get_snapshot().frame))


def _write_atomically(name: str, text: str) -> None:
    with open(name + ".part", "w", encoding="utf-8", errors="replace") as file:
        file.write(text)
    os.rename(name + ".part", name)


if __name__ == "__main__":
    sys.exit(main())
