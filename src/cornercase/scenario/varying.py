"""Scenarios in which numbers of the file vary: parameters take their place, and nothing else changes."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from lxml import etree

from cornercase._common import arguments
from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import require_other_file, write_files
from cornercase.scenario.concrete_files import read_beside
from cornercase.scenario.logical import LogicalScenario
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.parameter import Parameter
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.variable_list import Variable, variables_of
from cornercase.scenario.varied import read_ranges
from cornercase.scenario.xml import parse_xml
from cornercase.scenario.xml_text import XmlText

# So many values at most are looked at, whether each is that of a lane.
_MOST_LANES: Final = 1000
# Runs that a file of distributions has to name, although nothing here counts them.
_RUNS: Final = "100"
# A bound that is shown has fewer digits.
_ROUNDING: Final = 1e-6
_ENDING: Final = ".xosc"
_NO_DATE: Final = "1970-01-01T00:00:00"
# Attributes that name a file or folder from the folder of the scenario.
_PATHS: Final = {"LogicFile": "filepath", "SceneGraphFile": "filepath", "Directory": "path", "File": "filepath"}
_MODEL: Final = "model3d"
# Without these nothing runs.
_NEEDED: Final = ("LogicFile", "Directory")


@dataclass(frozen=True)
class VariedScenario:
    """A scenario in which numbers of the file vary, before it is written.

    Attributes
    ----------
    source : Scenario
        The file that they stand in.
    parameters : tuple of Parameter
        What varies, by the names of the parameters.
    variables : tuple of Variable
        The same as it stands in the file.
    """

    source: Scenario
    parameters: tuple[Parameter, ...]
    variables: tuple[Variable, ...]

    @classmethod
    def read(cls, scenario: Path | str | Scenario, ranges: Sequence[str], proposed: bool = False) -> VariedScenario:
        """Read what is to vary in a scenario.

        Parameters
        ----------
        scenario : path or Scenario
            OpenSCENARIO file.
        ranges : sequence of str
            As of `vary`.
        proposed : bool, default False
            Vary all that a range is proposed for.

        Returns
        -------
        VariedScenario

        Raises
        ------
        InputError
            There is no such name, a range is malformed or leaves what the number may be, or the file cannot be used.
        """
        source = Scenario.read(scenario.path if isinstance(scenario, Scenario) else scenario)
        known = {one.name: one for one in variables_of(source, parse_xml(_content(source), source.path))}
        chosen = {} if not proposed else {name: "" for name, one in known.items() if one.proposal}
        given: set[str] = set()
        for text in ranges:
            name, _, range_ = (part.strip() for part in text.partition("="))
            if name not in known:
                raise InputError(f"`vary` {text}: {source.path} has no '{name}' that could vary; {_meant(name, known)}")
            if name in given:
                raise InputError(f"`vary` {text}: {name} is varied twice; keep one of them.")
            if "=" in text and not range_:
                raise InputError(f"`vary` {text}: write it as NAME, NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
            given.add(name)
            chosen[name] = range_
        if not chosen and proposed:
            raise InputError(
                f"{source.path}: nothing is varied, since no range is proposed for any of its numbers; give one with"
                " `vary`, as NAME=LOW:HIGH."
            )
        if not chosen:
            raise InputError(f"{source.path}: nothing is varied; name what varies with `vary`.")
        parameters = tuple(_parameter(known[name], range_) for name, range_ in chosen.items())
        return cls(source, parameters, tuple(known[name] for name in chosen))

    def content(self, folder: Path) -> bytes:
        """Give the content of the file, as it is to lie in a folder.

        Parameters
        ----------
        folder : Path

        Returns
        -------
        bytes

        Raises
        ------
        InputError
            The road file or catalogs are named by an expression, which cannot be told from another folder.
        """
        content = _content(self.source)
        root, text = parse_xml(content, self.source.path), XmlText(content, self.source.path)
        elements = list(root.iter("*"))
        numbers = {element: k for k, element in enumerate(elements)}
        lines = []
        for one in self.variables:
            if not one.declared:
                written = text.attribute(*one.places[0])
                kind = "integer" if one.whole else "double"
                lines.append(
                    f'<ParameterDeclaration name="{one.parameter}" parameterType="{kind}" value="{written.strip()}"/>'
                )
                for number, attribute in one.places:
                    text.set(number, attribute, f"${one.parameter}")
        if lines:
            _declare(root, numbers, text, lines)
        if not _is_same_folder(folder, self.source.path.parent):
            for element, attribute, path in _moved_paths(self.source, root, folder):
                _require_text(path)
                text.set(numbers[element], attribute, path)
        return text.content()

    def beside(self, folder: Path) -> dict[Path, bytes]:
        """Give what has to lie beside the file in a folder and does not yet: files that it names without a path.

        Parameters
        ----------
        folder : Path

        Returns
        -------
        dict of Path to bytes

        Raises
        ------
        InputError
            Another file lies there by the name.
        """
        found: dict[Path, bytes] = {}
        for file in self.source.profiles_files:
            target = folder / file.name
            if _is_same_folder(folder, file.parent) or not file.is_file():
                continue
            content = read_beside(file, "Profiles")
            if not target.exists():
                found[target] = content
            elif target.read_bytes() != content:
                raise InputError(
                    f"{target}: is another file than {file}, which has to lie beside the scenario; choose another"
                    " folder."
                )
        return found

    def space_content(self, name: str) -> bytes:
        """Give the content of a file that says what varies in the scenario of a file name beside it.

        Parameters
        ----------
        name : str

        Returns
        -------
        bytes

        Raises
        ------
        InputError
            Some ranges have steps, others not.
        """
        parameters = _of_one_kind(self.parameters)
        header = self.source.root.find("FileHeader")
        date = "" if header is None else header.get("date", "")
        date = date if re.fullmatch(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d", date) else _NO_DATE
        root = etree.Element("OpenSCENARIO")
        words = {"revMajor": "1", "revMinor": "2", "date": date, "author": "cornercase"}
        head = etree.SubElement(root, "FileHeader", {**words, "description": f"What varies in {name}"})
        units = [one for one in parameters if one.unit]
        holder = etree.SubElement(head, "Properties") if units else head
        for one in units:
            etree.SubElement(holder, "Property", {"name": f"unit of {one.name}", "value": one.unit})
        body = etree.SubElement(root, "ParameterValueDistribution")
        etree.SubElement(body, "ScenarioFile", {"filepath": name})
        stepped = parameters[0].step is not None
        runs = {} if stepped else {"numberOfTestRuns": _RUNS}
        all_ = etree.SubElement(body, "Deterministic" if stepped else "Stochastic", runs)
        for one in parameters:
            tag = "DeterministicSingleParameterDistribution" if stepped else "StochasticDistribution"
            single = etree.SubElement(all_, tag, {"parameterName": one.name})
            inner = (
                etree.SubElement(single, "UniformDistribution")
                if one.step is None
                else etree.SubElement(single, "DistributionRange", {"stepWidth": _text(one.step)})
            )
            etree.SubElement(inner, "Range", {"lowerLimit": _text(one.low), "upperLimit": _text(one.high)})
        return etree.tostring(root, encoding="UTF-8", xml_declaration=True, pretty_print=True)

    def with_units(self, space: ParameterSpace) -> ParameterSpace:
        """Give a space the units of what varies in it.

        Parameters
        ----------
        space : ParameterSpace

        Returns
        -------
        ParameterSpace
        """
        units = {one.name: one.unit for one in self.parameters}
        parameters = [replace(one, unit=units.get(one.name) or one.unit) for one in space.parameters]
        return ParameterSpace(parameters, space.declarations)


def vary(
    scenario: Path | str | Scenario, ranges: Sequence[str], output: Path | str, *, proposed: bool = False
) -> LogicalScenario:
    """Write a scenario in which numbers of its file vary, and a file of their ranges beside it.

    Each number becomes a parameter, whose value is the number: run as it is, the new scenario gives the same recording.
    All else stays as it is written, but paths of roads and catalogs, which lead from the folder of the new file.

    Parameters
    ----------
    scenario : path or Scenario
        OpenSCENARIO file.
    ranges : sequence of str
        ``NAME=LOW:HIGH[:STEP]``, or ``NAME`` for the range that is proposed; names as `variables` gives them.
    output : path
        Scenario to write, ``NAME.xosc``; the ranges are written to ``NAME.space.xosc``.
    proposed : bool, default False
        Vary all that a range is proposed for.

    Returns
    -------
    LogicalScenario

    Raises
    ------
    InputError
        There is no such name, a range is malformed or leaves what the number may be, or a file cannot be used.

    See Also
    --------
    variables : Lists what could vary.

    Examples
    --------
    >>> from cornercase.scenario import vary
    >>> vary("examples/r157/cut_in.xosc", ["Ego.initial.x=90:110"], "varied/cut_in.xosc")
    <LogicalScenario 'varied/cut_in.xosc': Ego_initial_x 90 to 110 m>
    """
    output = arguments.path("output", output)
    _require_text(output)
    if output.suffix.lower() != _ENDING:
        raise InputError(f"`output` {output}: a scenario is written; name a file that ends with {_ENDING}.")
    varied = VariedScenario.read(scenario, arguments.texts("vary", ranges), arguments.flag("proposed", proposed))
    space = output.with_suffix(".space.xosc")
    for file in varied.source.files():
        require_other_file(output, file)
        require_other_file(space, file)
    contents = varied.beside(output.parent)
    contents |= {output: varied.content(output.parent), space: varied.space_content(output.name)}
    write_files(contents)
    return LogicalScenario.read(output, space)


def _require_text(path: Path | str) -> None:
    """Refuse a name that XML cannot hold."""
    try:
        str(path).encode()
    except UnicodeEncodeError as error:
        raise InputError(f"{path}: its name has characters that XML cannot hold; choose another one.") from error


def _content(scenario: Scenario) -> bytes:
    return scenario.contents()[scenario.path]


def _meant(name: str, known: dict[str, Variable]) -> str:
    words = suggestion(name, known)
    # A scenario has more names than a sentence.
    return words if words.startswith("did") else "'cornercase vary' with the scenario alone lists the names."


def _parameter(variable: Variable, range_: str) -> Parameter:
    """What varies, with the range that was given or proposed."""
    where = f"`vary` {variable.name}" + (f"={range_}" if range_ else "")
    if variable.fixed:
        raise InputError(f"{where}: cannot vary, since {variable.fixed}.")
    if not range_ and not variable.proposal:
        raise InputError(f"{where}: no range is proposed for it; give one, as {variable.name}=LOW:HIGH.")
    (read,) = read_ranges([f"{variable.name}={range_ or variable.proposal}"], "vary")
    least, most = variable.least, variable.most
    if least is not None and read.low < least - _ROUNDING:
        raise InputError(f"{where}: it has to be at least {least:.9g} {variable.unit}".rstrip() + ".")
    if most is not None and read.high > most + _ROUNDING:
        raise InputError(f"{where}: it has to be at most {most:.9g} {variable.unit}".rstrip() + ".")
    low = read.low if least is None else max(read.low, least)
    read = replace(read, low=low, high=read.high if most is None else min(read.high, most))
    if variable.whole and any(one is not None and one != round(one) for one in (read.low, read.high, read.step)):
        raise InputError(f"{where}: it takes whole numbers only.")
    step = 1.0 if variable.whole and read.step is None else read.step
    found = replace(read, name=variable.parameter, step=step, unit=variable.unit)
    if variable.lanes and (found.size or 0) <= _MOST_LANES:
        values = [round(found.low + k * float(step or 1.0)) for k in range(found.size or 0)]
        missing = [one for one in values if one not in variable.lanes]
        if missing:
            there = ", ".join(map(str, sorted(variable.lanes)))
            raise InputError(f"{where}: the road has no lane {missing[0]} there; its lanes are {there}.")
    return found


def _of_one_kind(parameters: Sequence[Parameter]) -> list[Parameter]:
    """Ranges that one distribution file can hold: all with steps or all without; whole numbers go with either."""
    with_steps = [one for one in parameters if one.step is not None and not _is_whole(one)]
    without = [one for one in parameters if one.step is None]
    if with_steps and without:
        raise InputError(
            f"`vary`: {with_steps[0].name} has a step and {without[0].name} has none, and a file of ranges takes steps"
            " for all or for none; add a step, as LOW:HIGH:STEP."
        )
    if without:
        return [replace(one, step=None) for one in parameters]
    return list(parameters)


def _is_whole(parameter: Parameter) -> bool:
    """Whether its steps are those that whole numbers have anyway."""
    return parameter.step == 1.0 and parameter.low == round(parameter.low)


def _declare(root: etree._Element, numbers: dict[etree._Element, int], text: XmlText, lines: list[str]) -> None:
    """Write declarations after those that are there."""
    holder = root.find("ParameterDeclarations")
    if holder is None:
        header = root.find("FileHeader")
        nest = ["<ParameterDeclarations>", *(f"  {one}" for one in lines), "</ParameterDeclarations>"]
        first = next(root.iterchildren("*"))
        text.insert(nest, numbers[first if header is None else header], after=header is not None)
        return
    declared = list(holder.iterchildren("*"))
    if declared:
        text.insert(lines, numbers[declared[-1]], after=True)
    else:
        text.fill(numbers[holder], lines)


def _moved_paths(source: Scenario, root: etree._Element, folder: Path) -> Iterator[tuple[etree._Element, str, str]]:
    """Where a path stands that leads to another place from another folder, and the path from there."""
    declared = {str(e.get("name")): e for e in root.iterfind("ParameterDeclarations/ParameterDeclaration")}
    moved: set[etree._Element] = set()
    for element in root.iter("*"):
        attribute = _PATHS.get(str(element.tag), _MODEL)
        path = str(element.get(attribute) or "").strip()
        holder = element
        if path.startswith("$") and path[1:] in declared:
            holder, attribute = declared[path[1:]], "value"
            path = str(holder.get("value") or "").strip()
        if not path and element.tag == "Directory" and element.get("path") is not None:
            # The folder of the scenario.
            path = "."
        if not path or (holder is not element and holder in moved):
            continue
        if path.startswith("$"):
            if element.tag in _NEEDED:
                raise InputError(
                    f"{source.path}, line {element.sourceline}: <{element.tag}> names a path by an expression, which"
                    f" leads elsewhere from {folder}; write the varied scenario into the folder of the scenario."
                )
            continue
        moved.add(holder)
        if (there := _from(folder, source.path.parent, path)) is not None:
            yield holder, attribute, there


def _from(folder: Path, before: Path, path: str) -> str | None:
    """A path that leads from another folder to where it led before; None where it stays."""
    plain = path.replace("\\", "/")
    if re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", plain) or plain.startswith("/") or not (before / plain).exists():
        return None
    target = os.path.realpath(before / plain)
    try:
        return Path(os.path.relpath(target, os.path.realpath(folder))).as_posix()
    except ValueError:
        # On another drive of Windows.
        return Path(target).as_posix()


def _is_same_folder(one: Path, other: Path) -> bool:
    return os.path.realpath(one) == os.path.realpath(other)


def _text(value: float) -> str:
    return str(int(value)) if float(value).is_integer() and abs(value) < 1e15 else repr(float(value))
