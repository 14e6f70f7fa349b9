"""A run leaves no state that affects a later run."""

from __future__ import annotations

import importlib
import pkgutil
from types import ModuleType

from conftest import EXAMPLES, same_recording
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin
from cornercase.simulators.pool._simulator import WorkerSimulator

ROOMS = ("cornercase.simulators.builtin", "cornercase.drivers", "cornercase.roads", "cornercase.scenario")
PATHS = [EXAMPLES / name / f"{name}.xosc" for name in ("x_intersection", "t_intersection")]


def values_of_modules() -> dict[str, str]:
    """What the modules and classes of the engine hold that is neither code nor a type, as text."""
    found: dict[str, str] = {}
    for room in ROOMS:
        package = importlib.import_module(room)
        names = [module.name for module in pkgutil.walk_packages(package.__path__, f"{room}.")]
        for module in map(importlib.import_module, [room, *names]):
            held: dict[tuple[str, ...], object] = {
                (module.__name__, name): value for name, value in vars(module).items()
            }
            for kind in [value for value in vars(module).values() if isinstance(value, type)]:
                if kind.__module__ == module.__name__:
                    held |= {(module.__name__, kind.__qualname__, name): value for name, value in vars(kind).items()}
            found |= {
                ".".join(key): repr(value)
                for key, value in held.items()
                if not key[-1].startswith("__")
                and not callable(value)
                and not hasattr(value, "__get__")
                and not isinstance(value, ModuleType)
            }
    return found


def run(path, **options):
    (recording,) = Builtin(duration=8.0, **options).run([ConcreteScenario(path)])
    return recording


def test_no_module_or_class_changes_in_a_run():
    # Loads what is not loaded yet.
    values_of_modules()
    for path in PATHS:
        run(path, drivers={"Ego": "normal"})
    before = values_of_modules()
    for path in PATHS:
        run(path, drivers={"Ego": "cautious"})
    assert values_of_modules() == before


def test_a_run_is_the_same_after_other_runs_and_beside_them():
    first = run(PATHS[0])
    simulator = Builtin(duration=8.0)
    # Two runs of one simulator whose results are taken in turns.
    one, other = (simulator.run([ConcreteScenario(path)] * 2) for path in PATHS)
    for _ in range(2):
        assert same_recording(next(one), first)
        next(other)
    assert same_recording(run(PATHS[0]), first)


def test_a_run_is_the_same_in_a_fresh_process():
    for path in PATHS:
        run(path)
    options = {"duration": 8.0, "drivers": {"Ego": "normal"}}
    with WorkerSimulator("builtin", options) as simulator:
        (fresh,) = simulator.run([ConcreteScenario(PATHS[0])])
    assert same_recording(fresh, run(PATHS[0], drivers={"Ego": "normal"}))
