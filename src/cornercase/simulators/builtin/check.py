"""What a scenario file holds, and whether it can be run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

import numpy as np
from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario import DRIVER_PROPERTY, ConcreteScenario, LogicalScenario, Parameter, Scenario, read_xml

_COUNTED: Final = ("ScenarioObject", "Story", "Act", "ManeuverGroup", "Event")

# Slope and bank from which a plane road is not quite the same.
_HILLY: Final = 0.02

# Of ASAM's schemas a file is held against that of its own version, or the newest that knows it.
_SCHEMAS: Final = {0: "1.0.0", 1: "1.1.1", 2: "1.2.0", 3: "1.3.0"}


@dataclass(frozen=True)
class Check:
    """What was found in a scenario file.

    Attributes
    ----------
    contents : dict of str to int
        How many there are of each kind of element.
    parameters, variables : tuple of str
    ignored : dict of str to int
        What changes nothing here, and how many of each: actions, conditions, the elevation of roads.
    schema : str or None
        Version of the schema that was looked at; None where it is not installed.
    invalid : tuple of str
        Where the file breaks the schema.
    space : tuple of str
        What is varied, a line for each.
    size : int or None
        Number of concrete scenarios; None where there are infinitely many or nothing is varied.
    trouble : tuple of str
        Why it cannot be run.
    """

    contents: dict[str, int]
    parameters: tuple[str, ...]
    variables: tuple[str, ...]
    ignored: dict[str, int]
    schema: str | None
    invalid: tuple[str, ...]
    space: tuple[str, ...]
    size: int | None
    trouble: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether the file is valid, as far as that could be seen, and can be run."""
        return not self.invalid and not self.trouble


def check_scenario(path: Path | str, space: Path | str | None = None) -> Check:
    """Look at a scenario file, and at the parameter space that goes with it.

    Parameters
    ----------
    path : path
        OpenSCENARIO file.
    space : path, optional
        ParameterValueDistribution file.

    Raises
    ------
    InputError
        A file is missing, is not XML, or is neither.
    """
    from cornercase.simulators.builtin.simulator import BuiltinSimulator

    scenario = Scenario.read(path)
    tags = Counter(str(e.tag) for e in scenario.root.iter() if isinstance(e.tag, str))
    trouble, lines, size = [], list[str](), None
    try:
        if space is None:
            concretes = [ConcreteScenario(Path(path))]
        else:
            logical = LogicalScenario.read(path, space)
            size, lines = logical.space.size, [_line(parameter) for parameter in logical.space.parameters]
            concretes = [logical.concrete(one) for one in logical.space.values(logical.space.middle())]
        (result,) = BuiltinSimulator(duration=0.05).run(concretes)
        if isinstance(result, Exception):
            trouble.append(f"{path}: {result}.")
    except InputError as error:
        trouble.append(str(error))
    version, invalid = _validate(scenario.root)
    if space is not None:
        _, more = _validate(read_xml(Path(space)))
        invalid += [f"{space}: {one}" for one in more]
    return Check(
        {tag: tags[tag] for tag in _COUNTED},
        scenario.parameters,
        tuple(e.get("name", "") for e in scenario.root.iterfind("VariableDeclarations/VariableDeclaration")),
        without_effect(scenario),
        version,
        tuple(invalid),
        tuple(lines),
        size,
        tuple(trouble),
    )


def without_effect(scenario: Scenario) -> dict[str, int]:
    """What of a file changes nothing in the builtin simulator, and how many of each.

    Actions, conditions, and roads that climb or bank by more than 2 %, since it drives in the plane.
    """
    from cornercase.simulators.builtin.actions.basic import WITHOUT_EFFECT
    from cornercase.simulators.builtin.storyboard.triggers import NEVER_TRUE

    tags = Counter(str(e.tag) for e in scenario.root.iter() if isinstance(e.tag, str))
    found = {tag: tags[tag] for tag in (*WITHOUT_EFFECT, *NEVER_TRUE) if tags[tag]}
    foreign = sum(
        all(item.get("name") != DRIVER_PROPERTY for item in controller.iterfind("Properties/Property"))
        for controller in scenario.root.iterfind(".//Controller")
    )
    if foreign:
        found["Controller of another program"] = foreign
    road = scenario.road_file()
    hilly = _hilly_roads(road) if road is not None and road.is_file() else 0
    return {**found, "elevation of roads": hilly} if hilly else found


def _hilly_roads(path: Path) -> int:
    hilly = 0
    for road in read_xml(path).iterfind("{*}road"):
        length = road.get("length", "0")
        climbs = (
            _steepest(road.findall("{*}elevationProfile/{*}elevation"), length, slope=True),
            _steepest(road.findall("{*}lateralProfile/{*}superelevation"), length, slope=False),
        )
        hilly += max(climbs) > _HILLY
    return hilly


def _steepest(records: list[etree._Element], length: str, slope: bool) -> float:
    """Largest slope (or value) of cubic records that follow each other on a road."""
    if not records:
        return 0.0
    try:
        cubics = [[float(record.get(key, 0.0)) for key in "sabcd"] for record in records]
        ends = [s for s, *_ in cubics[1:]] + [float(length)]
    except ValueError:
        return 0.0  # what is wrong with the road is said where it is read
    most = 0.0
    for (start, a, b, c, d), end in zip(cubics, ends, strict=True):
        s = np.linspace(0.0, max(end - start, 0.0), 20)
        curve = b + 2.0 * c * s + 3.0 * d * s**2 if slope else a + b * s + c * s**2 + d * s**3
        most = max(most, float(np.abs(curve).max()))
    return most


def _line(parameter: Parameter) -> str:
    if parameter.choices:
        return f"{parameter.name}: {len(parameter.choices)} choices"
    step = "" if parameter.step is None else f" in steps of {parameter.step:g}"
    return f"{parameter.name}: {parameter.low:g} to {parameter.high:g}{step} {parameter.unit}".rstrip()


def schema_errors(root: etree._Element) -> list[str] | None:
    """Errors by the schema of the version that a file says it has; None where the schema is not installed."""
    version, errors = _validate(root)
    return None if version is None else errors


def _validate(root: etree._Element) -> tuple[str | None, list[str]]:
    """Version of the schema, and errors with their lines."""
    header = root.find("FileHeader")
    minor = "" if header is None else header.get("revMinor", "")
    version = _SCHEMAS.get(int(minor) if minor.isdecimal() else -1, _SCHEMAS[3])
    try:
        folder = resources.files("qc_openscenario") / "schema"
    except ModuleNotFoundError:
        return None, []
    file = folder / version / "OpenSCENARIO.xsd"
    if not file.is_file():
        return None, []
    with resources.as_file(file) as local:
        schema = etree.XMLSchema(etree.parse(str(local)))
    schema.validate(root.getroottree())
    log = list(schema.error_log)  # type: ignore[call-overload]
    return version, [f"line {one.line}: {one.message}" for one in log][:20]
