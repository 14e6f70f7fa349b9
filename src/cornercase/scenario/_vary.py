"""Write scenarios in which varied parameters replace numbers."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common import validation
from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import check_output_differs_from_source, write_files
from cornercase.scenario._concrete_file import read_required_xml
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._logical import LogicalScenario
from cornercase.scenario._parameter import Parameter
from cornercase.scenario._range_syntax import parse_ranges
from cornercase.scenario._space import ParameterSpace
from cornercase.scenario._types import format_value
from cornercase.scenario._variables import Variable, list_variables_in
from cornercase.scenario._xml import parse_xml
from cornercase.scenario._xml_editor import XmlEditor

# Longer ranges of lane numbers are not checked against the road.
_MAX_CHECKED_LANES: Final = 1000
# The format requires a number of runs; it is not used.
_NUMBER_OF_TEST_RUNS: Final = "100"
# Tolerance for bounds, which are shown with fewer digits.
_BOUND_TOLERANCE: Final = 1e-6
_SCENARIO_SUFFIX: Final = ".xosc"
_DEFAULT_DATE: Final = "1970-01-01T00:00:00"
# Attributes with a path relative to the scenario.
_PATH_ATTRIBUTES: Final = {
    "LogicFile": "filepath",
    "SceneGraphFile": "filepath",
    "Directory": "path",
    "File": "filepath",
}
_MODEL_ATTRIBUTE: Final = "model3d"
# Paths without which nothing runs.
_REQUIRED_PATH_ELEMENTS: Final = ("LogicFile", "Directory")


@dataclass(frozen=True)
class VariedScenario:
    """A scenario file, the parameters to vary in it, and the numbers that these parameters replace."""

    file: ScenarioFile
    parameters: tuple[Parameter, ...]
    variables: tuple[Variable, ...]

    @classmethod
    def select(
        cls, scenario: Path | str | ScenarioFile, ranges: Sequence[str], proposed: bool = False
    ) -> VariedScenario:
        """Select the numbers to vary in a scenario.

        `ranges` has texts ``NAME=LOW:HIGH[:STEP]``, or ``NAME`` for the range that `list_variables` proposes. If
        `proposed` is True, all numbers with a proposed range are varied.
        """
        source = ScenarioFile.read(scenario.path if isinstance(scenario, ScenarioFile) else scenario)
        by_name = {
            variable.name: variable
            for variable in list_variables_in(source, parse_xml(_original_content(source), source.path))
        }
        chosen = {} if not proposed else {name: "" for name, variable in by_name.items() if variable.proposed_range}
        named: set[str] = set()
        for text in ranges:
            name, _, range_ = (part.strip() for part in text.partition("="))
            if name not in by_name:
                raise InputError(
                    f"`vary` {text}: {source.path} has no '{name}' that can be varied;"
                    f" {_suggest_variable(name, by_name)}"
                )
            if name in named:
                raise InputError(f"`vary` {text}: {name} is varied twice; keep one of them.")
            if "=" in text and not range_:
                raise InputError(f"`vary` {text}: write it as NAME, NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
            named.add(name)
            chosen[name] = range_
        if not chosen and proposed:
            raise InputError(
                f"{source.path}: nothing is varied, since no ranges are proposed; give one with `vary`, as"
                " NAME=LOW:HIGH."
            )
        if not chosen:
            raise InputError(f"{source.path}: nothing is varied; name numbers to vary with `vary`.")
        parameters = tuple(_create_parameter(by_name[name], range_) for name, range_ in chosen.items())
        return cls(source, parameters, tuple(by_name[name] for name in chosen))

    def scenario_content(self, folder: Path) -> bytes:
        """Return the content of the varied scenario file, with relative paths adapted to its new `folder`.

        Raises `InputError` if the path of a road file or catalog folder is an expression, which cannot be adapted.
        """
        content = _original_content(self.file)
        root, editor = parse_xml(content, self.file.path), XmlEditor(content, self.file.path)
        elements = list(root.iter("*"))
        element_indices = {element: k for k, element in enumerate(elements)}
        lines = []
        for variable in self.variables:
            if not variable.is_declared:
                value = editor.get_attribute(*variable.occurrences[0]).strip()
                kind = "integer" if variable.is_integer else "double"
                lines.append(
                    f'<ParameterDeclaration name="{variable.parameter_name}" parameterType="{kind}" value="{value}"/>'
                )
                for element_index, attribute in variable.occurrences:
                    editor.set_attribute(element_index, attribute, f"${variable.parameter_name}")
        if lines:
            _insert_declarations(root, element_indices, editor, lines)
        if not _is_same_folder(folder, self.file.path.parent):
            for element, attribute, path in _adapted_paths(self.file, root, folder):
                _require_encodable_path(path)
                editor.set_attribute(element_indices[element], attribute, path)
        return editor.edited_content()

    def companion_files(self, folder: Path) -> dict[Path, bytes]:
        """Return the contents of files that must be copied to `folder` for the scenario to work there, by new path."""
        missing: dict[Path, bytes] = {}
        for file in self.file.profiles_files:
            target = folder / file.name
            if _is_same_folder(folder, file.parent) or not file.is_file():
                continue
            content = read_required_xml(file, "Profiles")
            if not target.exists():
                missing[target] = content
            elif target.read_bytes() != content:
                raise InputError(
                    f"{target}: differs from {file}, but the new scenario needs a copy of that file here;"
                    " choose another folder."
                )
        return missing

    def distribution_content(self, scenario_name: str) -> bytes:
        """Return the content of the file with the parameter ranges, for the scenario file `scenario_name`."""
        parameters = _harmonize_steps(self.parameters)
        header = self.file.root.find("FileHeader")
        date = "" if header is None else header.get("date", "")
        date = date if re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", date) else _DEFAULT_DATE
        root = etree.Element("OpenSCENARIO")
        attributes = {"revMajor": "1", "revMinor": "2", "date": date, "author": "cornercase"}
        head = etree.SubElement(root, "FileHeader", {**attributes, "description": f"What varies in {scenario_name}"})
        units = [parameter for parameter in parameters if parameter.unit]
        holder = etree.SubElement(head, "Properties") if units else head
        for parameter in units:
            etree.SubElement(holder, "Property", {"name": f"unit of {parameter.name}", "value": parameter.unit})
        body = etree.SubElement(root, "ParameterValueDistribution")
        etree.SubElement(body, "ScenarioFile", {"filepath": scenario_name})
        stepped = parameters[0].step is not None
        runs = {} if stepped else {"numberOfTestRuns": _NUMBER_OF_TEST_RUNS}
        distributions = etree.SubElement(body, "Deterministic" if stepped else "Stochastic", runs)
        for parameter in parameters:
            tag = "DeterministicSingleParameterDistribution" if stepped else "StochasticDistribution"
            single = etree.SubElement(distributions, tag, {"parameterName": parameter.name})
            distribution = (
                etree.SubElement(single, "UniformDistribution")
                if parameter.step is None
                else etree.SubElement(single, "DistributionRange", {"stepWidth": format_value(parameter.step)})
            )
            etree.SubElement(
                distribution,
                "Range",
                {"lowerLimit": format_value(parameter.low), "upperLimit": format_value(parameter.high)},
            )
        return etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)

    def add_units(self, space: ParameterSpace) -> ParameterSpace:
        """Return the space, with the unit of each parameter taken from the number that the parameter replaces."""
        units = {parameter.name: parameter.unit for parameter in self.parameters}
        parameters = [
            replace(parameter, unit=units.get(parameter.name) or parameter.unit) for parameter in space.parameters
        ]
        return ParameterSpace(parameters, space.declarations)


def vary(
    scenario: Path | str | ScenarioFile, ranges: Sequence[str], output: Path | str, *, proposed: bool = False
) -> LogicalScenario:
    """Write a scenario in which numbers vary, and a file of their ranges next to it.

    Each number is replaced by a parameter, and becomes the default value of this parameter. With default values, the
    new scenario gives the same recording as the old one. Paths of roads and catalogs are adapted to the new folder.

    Parameters
    ----------
    scenario : path or ScenarioFile
        OpenSCENARIO file.
    ranges : sequence of str
        ``NAME=LOW:HIGH[:STEP]``, or ``NAME`` for the proposed range; names as in `list_variables`.
    output : path
        Scenario to write, ``NAME.xosc``; the ranges are written to ``NAME.space.xosc``.
    proposed : bool, default False
        Vary all numbers for which a range is proposed.

    Returns
    -------
    LogicalScenario

    Raises
    ------
    InputError
        A name is unknown, a range is malformed or exceeds the bounds of the number, or a file cannot be used.

    See Also
    --------
    list_variables : Lists the numbers that can be varied.

    Examples
    --------
    >>> from cornercase.scenario import vary
    >>> vary("examples/r157/cut_in.xosc", ["Ego.initial.x=90:110"], "varied/cut_in.xosc")
    <LogicalScenario 'varied/cut_in.xosc': Ego_initial_x 90 to 110 m>
    """
    output = validation.check_path("output", output)
    _require_encodable_path(output)
    if output.suffix.lower() != _SCENARIO_SUFFIX:
        raise InputError(f"`output` {output}: the output is a scenario; use a name that ends with {_SCENARIO_SUFFIX}.")
    varied = VariedScenario.select(
        scenario, validation.check_str_sequence("vary", ranges), validation.check_bool("proposed", proposed)
    )
    space = output.with_suffix(".space.xosc")
    for file in varied.file.all_paths():
        check_output_differs_from_source(output, file)
        check_output_differs_from_source(space, file)
    contents = varied.companion_files(output.parent)
    contents |= {output: varied.scenario_content(output.parent), space: varied.distribution_content(output.name)}
    write_files(contents)
    return LogicalScenario.read(output, space)


def _require_encodable_path(path: Path | str) -> None:
    """Refuse a path with characters that XML cannot contain."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: its name has characters that XML cannot contain; rename it.") from error


def _original_content(scenario: ScenarioFile) -> bytes:
    return scenario.read_all_files()[scenario.path]


def _suggest_variable(name: str, variables: dict[str, Variable]) -> str:
    hint = suggest_name(name, variables)
    # A scenario has too many names for a sentence.
    return hint if hint.startswith("did") else "'cornercase vary' with the scenario alone lists the names."


def _create_parameter(variable: Variable, range_: str) -> Parameter:
    """Create the parameter that replaces a number; `range_` is ``LOW:HIGH[:STEP]``, or empty for the proposed range."""
    where = f"`vary` {variable.name}" + (f"={range_}" if range_ else "")
    if variable.reason_fixed:
        raise InputError(f"{where}: cannot be varied: {variable.reason_fixed}.")
    if not range_ and not variable.proposed_range:
        raise InputError(f"{where}: no range is proposed; give one, as {variable.name}=LOW:HIGH.")
    (given,) = parse_ranges([f"{variable.name}={range_ or variable.proposed_range}"], "vary")
    least, most = variable.minimum, variable.maximum
    if least is not None and given.low < least - _BOUND_TOLERANCE:
        raise InputError(f"{where}: the minimum is {least:.9g} {variable.unit}".rstrip() + ".")
    if most is not None and given.high > most + _BOUND_TOLERANCE:
        raise InputError(f"{where}: the maximum is {most:.9g} {variable.unit}".rstrip() + ".")
    low = given.low if least is None else max(given.low, least)
    given = replace(given, low=low, high=given.high if most is None else min(given.high, most))
    if variable.is_integer and any(
        number is not None and number != round(number) for number in (given.low, given.high, given.step)
    ):
        raise InputError(f"{where}: this number is an integer; use whole numbers.")
    step = 1.0 if variable.is_integer and given.step is None else given.step
    parameter = replace(
        given, name=variable.parameter_name, step=step, unit=variable.unit, is_integer=variable.is_integer
    )
    if variable.allowed_lanes and (parameter.size or 0) <= _MAX_CHECKED_LANES:
        values = [round(parameter.low + k * float(step or 1.0)) for k in range(parameter.size or 0)]
        absent = [number for number in values if number not in variable.allowed_lanes]
        if absent:
            existing = ", ".join(map(str, sorted(variable.allowed_lanes)))
            raise InputError(f"{where}: the road has no lane {absent[0]} at this position; its lanes are {existing}.")
    return parameter


def _harmonize_steps(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Make all ranges stepped or all continuous, since a distribution file cannot mix both.

    If some ranges have no step, ranges of integers lose their step of 1, and get it back when the file is read.
    Raises `InputError` if some ranges have no step and others have another step.
    """
    with_steps = [
        parameter
        for parameter in parameters
        if parameter.step is not None and not (parameter.is_integer and parameter.step == 1.0)
    ]
    without = [parameter for parameter in parameters if parameter.step is None]
    if with_steps and without:
        raise InputError(
            f"`vary`: {with_steps[0].name} has a step and {without[0].name} has none, but a file of ranges has steps"
            " for all or for none; add a step, as LOW:HIGH:STEP."
        )
    if without:
        return [replace(parameter, step=None) for parameter in parameters]
    return list(parameters)


def _insert_declarations(
    root: etree._Element, element_indices: dict[etree._Element, int], editor: XmlEditor, lines: list[str]
) -> None:
    """Insert lines with parameter declarations after the existing declarations of the file."""
    holder = root.find("ParameterDeclarations")
    if holder is None:
        header = root.find("FileHeader")
        nest = ["<ParameterDeclarations>", *(f"  {line}" for line in lines), "</ParameterDeclarations>"]
        first_child = next(root.iterchildren("*"))
        editor.insert_sibling_lines(
            nest, element_indices[first_child if header is None else header], after=header is not None
        )
        return
    declared = list(holder.iterchildren("*"))
    if declared:
        editor.insert_sibling_lines(lines, element_indices[declared[-1]], after=True)
    else:
        editor.insert_children(element_indices[holder], lines)


def _adapted_paths(
    scenario: ScenarioFile, root: etree._Element, folder: Path
) -> Iterator[tuple[etree._Element, str, str]]:
    """Yield an element, an attribute and a new value for each relative path that must change for `folder`.

    `folder` is the new folder of the scenario file.
    """
    declared = {str(e.get("name")): e for e in root.iterfind("ParameterDeclarations/ParameterDeclaration")}
    changed: set[etree._Element] = set()
    for element in root.iter("*"):
        attribute = _PATH_ATTRIBUTES.get(str(element.tag), _MODEL_ATTRIBUTE)
        path = str(element.get(attribute) or "").strip()
        holder = element
        if path.startswith("$") and path[1:] in declared:
            holder, attribute = declared[path[1:]], "value"
            path = str(holder.get("value") or "").strip()
        if not path and element.tag == "Directory" and element.get("path") is not None:
            # An empty path means the scenario's folder.
            path = "."
        if not path or (holder is not element and holder in changed):
            continue
        if path.startswith("$"):
            if element.tag in _REQUIRED_PATH_ELEMENTS:
                raise InputError(
                    f"{scenario.path}, line {element.sourceline}: <{element.tag}> has an expression"
                    f" as path, which cannot"
                    f" be adapted to {folder}; write the varied scenario into the folder of the scenario."
                )
            continue
        changed.add(holder)
        if (new_path := _adapt_relative_path(folder, scenario.path.parent, path)) is not None:
            yield holder, attribute, new_path


def _adapt_relative_path(folder: Path, old_folder: Path, path: str) -> str | None:
    """Return a path relative to `folder` of a file that has a path relative to `old_folder`.

    Return None if the path need not change: it is absolute or a network address, or the file does not exist.
    """
    posix = path.replace("\\", "/")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", posix) or posix.startswith("/") or not (old_folder / posix).exists():
        return None
    target = os.path.realpath(old_folder / posix)
    try:
        return Path(os.path.relpath(target, os.path.realpath(folder))).as_posix()
    except ValueError:
        # Windows: on another drive.
        return Path(target).as_posix()


def _is_same_folder(folder: Path, other: Path) -> bool:
    return os.path.realpath(folder) == os.path.realpath(other)
