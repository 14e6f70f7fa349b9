"""Whether a scenario gives the same alone and among others, with its parameters varied."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from cornercase._common.errors import InputError, SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._scope import Scope
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Builtin

ROOT = Path(__file__).parents[2]
REFERENCE = ROOT.parent / "shared" / "reference" / "openscenario"


def scenario_files(*folders: Path) -> list[Path]:
    """Scenario files in folders; catalogs and parameter distributions are none."""
    found = []
    for folder in folders:
        for path in sorted(folder.rglob("*.xosc")):
            try:
                root = read_xml(path)
            except InputError:
                continue
            if root.find("Storyboard") is not None:
                found.append(path)
    return found


def varied(scenario: ScenarioFile, seed: int = 0, most: int = 40) -> list[dict[str, Value]]:
    """Values of parameters: the file's own, each changed in two ways, and some of all of them changed at once."""
    random = np.random.default_rng(seed)
    scope = Scope.from_file(str(scenario.path), scenario.root, [{}], scenario.find_catalog_entry)
    changes: dict[str, list[Value]] = {}
    for declaration in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration"):
        name, kind = declaration.get("name", ""), declaration.get("parameterType", "string")
        value = scope.parameter_values[name]
        if kind in ("integer", "int", "unsignedInt", "unsignedShort"):
            changes[name] = [float(value) + 1.0, max(float(value) - 1.0, 0.0)]
        elif kind == "boolean":
            changes[name] = ["false", "true"]
        elif kind == "double":
            own = float(value)
            changes[name] = [own * 1.1 + 0.1, own * 0.8]
        else:
            others = {
                str(one) for other, one in scope.parameter_values.items() if isinstance(one, str) and other != name
            }
            changes[name] = ["no such thing", *sorted(others)[:1]]
    single: list[dict[str, Value]] = [{name: one} for name, choices in changes.items() for one in choices]
    mixed: list[dict[str, Value]] = [
        {name: choices[int(random.integers(len(choices)))] for name, choices in changes.items()
         if len(choices) and random.random() < 0.3}
        for _ in range(4)
    ]  # fmt: skip
    if len(single) > most:
        single = [single[k] for k in sorted(random.choice(len(single), most, replace=False).tolist())]
    return [{}, *single, *mixed] if changes else [{}, {}]


def outcome(result: Recording | SimulationError | InputError) -> object:
    """What came out, so that equal ones are equal to the last bit."""
    if isinstance(result, Exception):
        return str(result)
    arrays = (result.time, result.x, result.y, result.heading, result.speed, result.acceleration, result.length,
              result.width, result.center_x)  # fmt: skip
    return result.names, result.object_types, tuple(a.tobytes() for a in arrays), result.collisions


def differing(path: Path, values: Sequence[Mapping[str, Value]], duration: float, **options: object) -> list[int]:
    """Scenarios of a file that give something else among the others than alone, by their place."""
    scenario = ScenarioFile.read(path)
    concretes = [ConcreteScenario(path, one, scenario) for one in values]
    simulator = Builtin(duration=duration, **options)  # type: ignore[arg-type]
    together = [outcome(one) for one in simulator.run(concretes)]
    # Backwards, so that another one is the first of what is run together.
    turned = [outcome(one) for one in simulator.run(concretes[::-1])][::-1]
    alone = [outcome(next(iter(simulator.run([one])))) for one in concretes]
    return [k for k in range(len(concretes)) if not together[k] == turned[k] == alone[k]]


if __name__ == "__main__":
    # All of them, which takes minutes: python tests/helpers/isolation.py [WORD OF A PATH]…
    import sys

    for path in scenario_files(REFERENCE, ROOT / "examples"):
        if len(sys.argv) == 1 or any(word in str(path) for word in sys.argv[1:]):
            values = varied(ScenarioFile.read(path), most=6)
            found = differing(path, values, 10.0)
            sys.stdout.write(f"{path.name}: {'the same' if not found else [values[k] for k in found]}\n")
            sys.stdout.flush()
