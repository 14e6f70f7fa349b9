"""Check of a scenario file: its contents, the schema, and whether the scenario can be run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.support_table import Notice, NoticeLabel
from cornercase._common.text.element_locations import prefix_file
from cornercase.drivers._resolve import DriverLike, check_drivers, may_steer, resolve_driver
from cornercase.scenario import ConcreteScenario, LogicalScenario, ParameterSpace
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._normalize import normalize_openscenario
from cornercase.scenario._xml import read_xml
from cornercase.simulators.builtin._ignored_content import collect_notices
from cornercase.simulators.builtin._simulator import Builtin

_COUNTED_ELEMENTS: Final = ("ScenarioObject", "Story", "Act", "ManeuverGroup", "Event")

# ASAM's schema by minor version; files of other versions are validated by the newest one.
_SCHEMA_VERSIONS: Final = {0: "1.0.0", 1: "1.1.1", 2: "1.2.0", 3: "1.3.0"}


@dataclass(frozen=True, repr=False)
class Check:
    """Result of checking a scenario file.

    Attributes
    ----------
    path : Path
        The scenario file.
    contents : dict of str to int
        Number of elements by kind.
    parameters, variables : tuple of str
        Names of declared parameters and variables.
    drivers : mapping of str to str or None
        Driver that the file gives to each entity; None if the storyboard moves the entity, at least at the beginning.
    notices : tuple of Notice
        Parts that have no effect in the builtin simulator, and why: parts of the scenario file, its catalogs, its road
        file and the parameter space.
    schema : str or None
        Version of the schema used for validation; None if the schema is not installed.
    schema_errors : tuple of str
        Schema violations of the file and of the space. Violations that are corrected when a file is read are listed
        only if `strict` was given.
    space : ParameterSpace or None
        The parameter space; None if no space was given, or the space cannot be used. Parameters of drivers are not
        checked, since a search may use other drivers than the file.
    run_errors : tuple of str
        Reasons why the scenario cannot be run; empty if it can be run.
    standard_violations : tuple of str
        Violations of the standard that do not prevent reading, with the rule; empty unless `strict` was given.

    Examples
    --------
    >>> import cornercase as cc
    >>> check = cc.check("examples/r157/cut_in.xosc")
    >>> check.is_valid, check.drivers
    (True, {'Ego': 'cc-human', 'Other': None})
    >>> check.parameters
    ('ego_kmh', 'other_kmh', 'gap', 'lateral_speed')
    """

    path: Path
    contents: dict[str, int]
    parameters: tuple[str, ...]
    variables: tuple[str, ...]
    drivers: Mapping[str, str | None]
    notices: tuple[Notice, ...]
    schema: str | None
    schema_errors: tuple[str, ...]
    space: ParameterSpace | None
    run_errors: tuple[str, ...]
    standard_violations: tuple[str, ...] = ()

    @property
    def is_valid(self) -> bool:
        """Whether the file can be run, fits the schema (if installed) and, if `strict` was given, fits the standard."""
        return not self.schema_errors and not self.run_errors and not self.standard_violations

    def __repr__(self) -> str:
        contents = ", ".join(f"{count} {kind}" for kind, count in self.contents.items() if count)
        validity = "schema not installed" if self.schema is None else f"schema {self.schema}: "
        if self.schema is not None:
            validity += f"{len(self.schema_errors)} errors" if self.schema_errors else "valid"
        lines = [f"<Check of {self.path.name}: {'cannot' if self.run_errors else 'can'} be run, {validity}; {contents}"]
        lines += [notice.sentence for notice in self.notices]
        return "\n  ".join([*lines, *self.schema_errors, *self.standard_violations, *self.run_errors]) + ">"


def check(
    scenario: Path | str | ScenarioFile,
    space: Path | str | None = None,
    *,
    strict: bool = False,
    drivers: Mapping[str, DriverLike] | None = None,
) -> Check:
    """Check a scenario file: its contents, what the builtin simulator ignores, and whether it is valid and can be run.

    The file is validated by ASAM's schema if the extra ``cornercase[validate]`` is installed. The scenario is run for
    one time step with the given drivers, and with the parameter values of the file or from the middle of the space.

    Parameters
    ----------
    scenario : path or ScenarioFile
        OpenSCENARIO file.
    space : path, optional
        ParameterValueDistribution file.
    strict : bool, default False
        Also reject violations of the standard that do not prevent reading: all notices with the label ``adapted``.
    drivers : mapping of str to str, SystemUnderTest or Driver, optional
        By entity, as for `simulate`.

    Returns
    -------
    Check

    Raises
    ------
    InputError
        A file is missing or is not XML, the scenario file is not a scenario, or a driver or its entity does not exist.

    Examples
    --------
    >>> import cornercase.simulators as simulators
    >>> found = simulators.check("examples/t_intersection/t_intersection.xosc")
    >>> found.is_valid, found.contents["ScenarioObject"]
    (True, 2)
    """
    file = scenario if isinstance(scenario, ScenarioFile) else ScenarioFile.read(scenario)
    given = {entity: resolve_driver(driver) for entity, driver in check_drivers(drivers).items()}
    for entity in given:
        if entity not in file.entities:
            raise InputError(
                f"`drivers` {entity}: {file.path} has no entity '{entity}'; {suggest_name(entity, file.entities)}"
            )
    tags = Counter(str(e.tag) for e in file.root.iter() if isinstance(e.tag, str))
    run_errors, parameter_space = [], None
    own_drivers: dict[str, str | None] = {}
    try:
        concrete = ConcreteScenario(file.path, {}, file)
        if space is not None:
            parameter_space = LogicalScenario.read(file, space).space
            (values,) = parameter_space.values(parameter_space.center_point())
            # The drivers of the file need not be those that the search is given.
            own = {name: value for name, value in values.items() if name in file.parameters}
            concrete = ConcreteScenario(file.path, own, file)
        (result,) = Builtin(duration=0.05, drivers=given).run([concrete])
        if isinstance(result, Exception):
            run_errors.append(prefix_file(file.path, f"{result}."))
    except InputError as error:
        run_errors.append(str(error))
    with suppress(InputError):
        own_drivers = {name: file.drivers.get(name) for name in file.entities}
    version, schema_violations = _validate_by_schema(file.parse_unnormalized() if strict else file.root)
    if space is not None:
        space_root = read_xml(Path(space))
        if not strict:
            normalize_openscenario(space_root)
        _, space_violations = _validate_by_schema(space_root)
        schema_violations += [f"{space}: {violation}" for violation in space_violations]
    notices = collect_notices(file, is_complete=not run_errors)
    if any(may_steer(driver) for driver in given.values()):
        notices = tuple(notice for notice in notices if notice.parts != ("<Axles>",))
    return Check(
        path=file.path,
        contents={tag: tags[tag] for tag in _COUNTED_ELEMENTS},
        parameters=file.parameters,
        variables=tuple(e.get("name", "") for e in file.root.iterfind("VariableDeclarations/VariableDeclaration")),
        drivers=own_drivers,
        notices=notices,
        schema=version,
        schema_errors=tuple(schema_violations),
        space=parameter_space,
        run_errors=tuple(run_errors),
        standard_violations=tuple(
            f"{notice}. The standard: {notice.rule}" if notice.rule else str(notice)
            for notice in notices
            if strict and notice.label is NoticeLabel.ADAPTED
        ),
    )


def schema_errors(root: etree._Element) -> list[str] | None:
    """Return violations of the schema of the file's version, one line each; None if the schema is not installed."""
    version, errors = _validate_by_schema(root)
    return None if version is None else errors


def _validate_by_schema(root: etree._Element) -> tuple[str | None, list[str]]:
    """Validate a file by ASAM's schema; return its version (None if not installed) and at most 20 violations."""
    header = root.find("FileHeader")
    minor = "" if header is None else header.get("revMinor", "")
    version = _SCHEMA_VERSIONS.get(int(minor) if minor.isdecimal() and len(minor) < 4 else -1, _SCHEMA_VERSIONS[3])
    try:
        folder = resources.files("qc_openscenario") / "schema"
    except ModuleNotFoundError:
        return None, []
    file = folder / version / "OpenSCENARIO.xsd"
    if not file.is_file():
        return None, []
    with resources.as_file(file) as schema_path:
        schema = etree.XMLSchema(etree.parse(str(schema_path)))
    schema.validate(root.getroottree())
    entries = list(schema.error_log)  # type: ignore[call-overload]
    return version, [f"line {entry.line}: {entry.message}" for entry in entries][:20]
