"""What a scenario file holds, and whether it can be run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase.scenario import ConcreteScenario, LogicalScenario, Parameter, Scenario, read_xml
from cornercase.simulators.builtin.effect import without_effect
from cornercase.simulators.builtin.simulator import BuiltinSimulator

_COUNTED: Final = ("ScenarioObject", "Story", "Act", "ManeuverGroup", "Event")

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
