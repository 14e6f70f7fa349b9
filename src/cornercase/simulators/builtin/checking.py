"""What a scenario file holds, and whether it can be run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError
from cornercase._common.ledger import Label, Notice
from cornercase._common.places import of_file
from cornercase.scenario import ConcreteScenario, LogicalScenario, ParameterSpace, Scenario, read_xml
from cornercase.simulators.builtin.effect import notices_after_reading
from cornercase.simulators.builtin.simulator import BuiltinSimulator

_COUNTED: Final = ("ScenarioObject", "Story", "Act", "ManeuverGroup", "Event")

# ASAM's schema by minor version; files of any other are validated by the newest.
_SCHEMAS: Final = {0: "1.0.0", 1: "1.1.1", 2: "1.2.0", 3: "1.3.0"}


@dataclass(frozen=True, repr=False)
class Check:
    """What was found in a scenario file.

    Attributes
    ----------
    path : Path
        The scenario file.
    contents : dict of str to int
        How many there are of each kind of element.
    parameters, variables : tuple of str
        Names of those that it declares.
    notices : tuple of Notice
        What of the scenario and its catalogs, roads and space changes nothing in the builtin simulator, and why.
    schema : str or None
        Version of the schema that it was held against; None where the schema is not installed.
    invalid : tuple of str
        Where the file, or that of the space, breaks the schema; what is adapted counts only where that was asked for.
    space : ParameterSpace or None
        What is varied; None where no space was given, or it cannot be used.
    trouble : tuple of str
        Why the scenario cannot be run.
    adapted : tuple of str
        What breaks the standard and is read all the same, with its rule; empty unless `strict` asks for it.
    """

    path: Path
    contents: dict[str, int]
    parameters: tuple[str, ...]
    variables: tuple[str, ...]
    notices: tuple[Notice, ...]
    schema: str | None
    invalid: tuple[str, ...]
    space: ParameterSpace | None
    trouble: tuple[str, ...]
    adapted: tuple[str, ...] = ()

    @property
    def good(self) -> bool:
        """Whether the file can be run, breaks no schema that is installed and, where that was asked for, no rule."""
        return not self.invalid and not self.trouble and not self.adapted

    def __repr__(self) -> str:
        held = ", ".join(f"{count} {kind}" for kind, count in self.contents.items() if count)
        validity = "schema not installed" if self.schema is None else f"schema {self.schema}: "
        if self.schema is not None:
            validity += f"{len(self.invalid)} errors" if self.invalid else "valid"
        lines = [f"<Check of {self.path.name}: {'cannot' if self.trouble else 'can'} be run, {validity}; {held}"]
        lines += [notice.sentence for notice in self.notices]
        return "\n  ".join([*lines, *self.invalid, *self.adapted, *self.trouble]) + ">"


def check(scenario: Path | str | Scenario, space: Path | str | None = None, *, strict: bool = False) -> Check:
    """Tell what a scenario file holds, what of it has no effect here, and whether it is valid and can be run.

    It is held against ASAM's schema, where the extra ``cornercase[validate]`` is installed, and run for one time step:
    with the parameters' own values, or those in the middle of the space.

    Parameters
    ----------
    scenario : path or Scenario
        OpenSCENARIO file.
    space : path, optional
        ParameterValueDistribution file.
    strict : bool, default False
        Whether what breaks the standard is refused, though it can be read: all notices of the label ``adapted``.

    Returns
    -------
    Check

    Raises
    ------
    InputError
        A file is missing, is not XML, or is neither.

    Examples
    --------
    >>> import cornercase.simulators as simulators
    >>> found = simulators.check("examples/t_intersection/t_intersection.xosc")
    >>> found.good, found.contents["ScenarioObject"]
    (True, 2)
    """
    file = scenario if isinstance(scenario, Scenario) else Scenario.read(scenario)
    tags = Counter(str(e.tag) for e in file.root.iter() if isinstance(e.tag, str))
    trouble, varied = [], None
    try:
        concrete = ConcreteScenario(file.path, {}, file)
        if space is not None:
            varied = LogicalScenario.read(file, space).space
            (values,) = varied.values(varied.middle())
            concrete = ConcreteScenario(file.path, values, file)
        (result,) = BuiltinSimulator(duration=0.05).run([concrete])
        if isinstance(result, Exception):
            trouble.append(of_file(file.path, f"{result}."))
    except InputError as error:
        trouble.append(str(error))
    version, invalid = _validate(file.as_written() if strict else file.root)
    if space is not None:
        _, more = _validate(read_xml(Path(space)))
        invalid += [f"{space}: {one}" for one in more]
    notices = notices_after_reading(file, read=not trouble)
    return Check(
        path=file.path,
        contents={tag: tags[tag] for tag in _COUNTED},
        parameters=file.parameters,
        variables=tuple(e.get("name", "") for e in file.root.iterfind("VariableDeclarations/VariableDeclaration")),
        notices=notices,
        schema=version,
        invalid=tuple(invalid),
        space=varied,
        trouble=tuple(trouble),
        adapted=tuple(_breach(notice) for notice in notices if strict and notice.label is Label.ADAPTED),
    )


def _breach(notice: Notice) -> str:
    """What breaks the standard, and the rule that it breaks."""
    return f"{notice}. The standard: {notice.rule}" if notice.rule else str(notice)


def schema_errors(root: etree._Element) -> list[str] | None:
    """Errors by the schema of the version that a file says it has; None where the schema is not installed.

    Parameters
    ----------
    root : lxml element

    Returns
    -------
    list of str, optional
        A line for each.
    """
    version, errors = _validate(root)
    return None if version is None else errors


def _validate(root: etree._Element) -> tuple[str | None, list[str]]:
    """Version of the schema, and errors with their lines."""
    header = root.find("FileHeader")
    minor = "" if header is None else header.get("revMinor", "")
    version = _SCHEMAS.get(int(minor) if minor.isdecimal() and len(minor) < 4 else -1, _SCHEMAS[3])
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
