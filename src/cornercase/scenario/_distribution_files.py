"""Read varied parameters from OpenSCENARIO ParameterValueDistribution files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.tracked_xml import find_by_name, find_untracked
from cornercase._common.text.element_locations import add_location_to_input_errors, format_location
from cornercase._common.text.parse_number import parse_number
from cornercase.scenario._distributions import read_distribution
from cornercase.scenario._parameter import Parameter
from cornercase.scenario._range_syntax import create_range, require_unique_names
from cornercase.scenario._xml import XmlFileCache


def read_distribution_file(path: Path | str, cache: XmlFileCache | None = None) -> list[Parameter]:
    """Read the varied parameters of an OpenSCENARIO ParameterValueDistribution file."""
    distribution = _find_distribution_element(path, cache)
    parameters = []
    for tag, reader in _READERS.items():
        for element in distribution.iterfind(f".//{tag}"):
            with add_location_to_input_errors(element, str(path)):
                parameters.append(reader(element, str(path)))
    with add_location_to_input_errors(distribution, str(path)):
        if not parameters:
            raise InputError(f"{path}: the file varies no parameter; add a distribution for at least one parameter.")
        require_unique_names([name for p in parameters for name in p.assigned_names], str(path))
    return [_add_unit(parameter, distribution) for parameter in parameters]


def read_scenario_path(path: Path | str, cache: XmlFileCache | None = None) -> Path:
    """Return the path of the scenario file that a ParameterValueDistribution file belongs to."""
    file = _find_distribution_element(path, cache).find("ScenarioFile")
    name = "" if file is None else file.get("filepath", "")
    if not name or re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name):
        location = str(path) if file is None else format_location(file, str(path))
        raise InputError(f"{location}: <ScenarioFile> must name a local file.")
    return Path(path).parent / name


def remove_from_value_sets(parameter: Parameter, names: set[str]) -> Parameter | None:
    """Remove the scenario parameters `names` from the value sets of a varied parameter, to vary them separately.

    A value set has values of several scenario parameters that vary together. A parameter without value sets is returned
    unchanged. Return None if nothing remains in the value sets.
    """
    if not parameter.value_sets:
        return parameter
    sets = tuple(
        dict.fromkeys(tuple(member for member in members if member[0] not in names) for members in parameter.value_sets)
    )
    return _parameter_from_value_sets(sets) if sets[0] else None


def _find_distribution_element(path: Path | str, cache: XmlFileCache | None) -> Any:
    root = (cache or XmlFileCache()).get_root(Path(path))
    element = root.find("ParameterValueDistribution")
    if element is None:
        location = format_location(root, str(path))
        raise InputError(f"{location}: <{root.tag}> has no <ParameterValueDistribution>; `space` needs one.")
    return element


def _read_value_sets(element: Any, path: str) -> Parameter:
    """Read scenario parameters that vary together, as one varied parameter with a choice for each set of values."""
    sets = []
    for value_set in element.iterfind("ValueSetDistribution/ParameterValueSet"):
        members = [(e.get("parameterRef", "").lstrip("$"), e.get("value", "")) for e in value_set.iterchildren("*")]
        sets.append(tuple(sorted(members)))
    names = [name for name, _ in sets[0]] if sets else []
    if not names or any([name for name, _ in members] != names for members in sets):
        raise InputError(
            f"{path}: each <ParameterValueSet> must set at least one parameter, and all must set the same ones."
        )
    return _parameter_from_value_sets(tuple(dict.fromkeys(sets)))


def _parameter_from_value_sets(value_sets: tuple[tuple[tuple[str, str], ...], ...]) -> Parameter:
    # Label sets by the members that differ.
    differing = [k for k in range(len(value_sets[0])) if len({members[k] for members in value_sets}) > 1] or [0]
    labels = tuple(", ".join(members[k][1] for k in differing) for members in value_sets)
    if len(set(labels)) < len(labels):
        labels = tuple(f"{k + 1}: {label}" for k, label in enumerate(labels))
    name = ", ".join(value_sets[0][k][0] for k in differing)
    return Parameter(name, 0.0, len(value_sets) - 1.0, None, labels, value_sets=value_sets)


def _read_single_distribution(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    where = f"{path}, parameter {name}"
    span, choice_set = element.find("DistributionRange"), element.find("DistributionSet")
    if span is not None:
        bounds = span.find("Range")
        if bounds is None:
            raise InputError(f"{where}: <DistributionRange> has no <Range>.")
        low, high, step = (
            _parse_float(text, where)
            for text in (bounds.get("lowerLimit"), bounds.get("upperLimit"), span.get("stepWidth"))
        )
        return create_range(name, low, high, step, where)
    if choice_set is not None:
        choices = tuple(dict.fromkeys(e.get("value", "") for e in choice_set.iterfind("Element")))
        if not choices:
            raise InputError(f"{where}: <DistributionSet> is empty.")
        return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
    raise InputError(
        f"{where}: needs a <DistributionRange> or a <DistributionSet>; user-defined distributions are not read."
    )


def _read_stochastic_distribution(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    law, choices = read_distribution(element, path)
    step = 1.0 if law.kind == "poisson" else None
    return Parameter(name, law.low, law.high, step, choices, distribution=law)


def _parse_float(text: str | None, location: str) -> float:
    try:
        return parse_number(text or "")
    except ValueError:
        raise InputError(f"{location}: '{text}' is not a number.") from None


_READERS: Final[Mapping[str, Callable[[Any, str], Parameter]]] = {
    "DeterministicMultiParameterDistribution": _read_value_sets,
    "DeterministicSingleParameterDistribution": _read_single_distribution,
    "StochasticDistribution": _read_stochastic_distribution,
}


def _add_unit(parameter: Parameter, distribution: Any) -> Parameter:
    """Set the unit of a parameter from the property ``unit of NAME`` in the file header, if there is one."""
    properties = find_untracked(distribution.getparent(), "FileHeader", "Properties", "Property")
    item = find_by_name(properties, f"unit of {parameter.name}")
    return parameter if item is None else replace(parameter, unit=item.get("value", ""))
