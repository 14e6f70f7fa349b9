"""Read varied parameters from OpenSCENARIO ParameterValueDistribution files."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.numbers import number_of
from cornercase._common.places import place_of, placed
from cornercase._common.recorded_xml import named, unrecorded
from cornercase.scenario.distributions import read_distribution
from cornercase.scenario.parameter import Parameter
from cornercase.scenario.varied import ranged, require_names
from cornercase.scenario.xml import XmlFiles


def read_distribution_file(path: Path | str, files: XmlFiles | None = None) -> list[Parameter]:
    """Read the varied parameters of an OpenSCENARIO ParameterValueDistribution file."""
    distribution = _distribution_element(path, files)
    parameters = []
    for tag, reader in _DISTRIBUTIONS.items():
        for element in distribution.iterfind(f".//{tag}"):
            with placed(element, str(path)):
                parameters.append(reader(element, str(path)))
    with placed(distribution, str(path)):
        if not parameters:
            raise InputError(f"{path}: varies no parameter.")
        require_names([name for p in parameters for name in p.assigns], str(path))
    return [_with_unit(parameter, distribution) for parameter in parameters]


def scenario_file_of(path: Path | str, files: XmlFiles | None = None) -> Path:
    """Return the scenario that a ParameterValueDistribution file belongs to."""
    file = _distribution_element(path, files).find("ScenarioFile")
    name = "" if file is None else file.get("filepath", "")
    if not name or re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name):
        location = str(path) if file is None else place_of(file, str(path))
        raise InputError(f"{location}: <ScenarioFile> must name a local file.")
    return Path(path).parent / name


def without(parameter: Parameter, names: set[str]) -> Parameter | None:
    """Remove the members of a parameter that are varied separately; None if none is left."""
    if not parameter.sets:
        return parameter
    sets = tuple(
        dict.fromkeys(tuple(member for member in members if member[0] not in names) for members in parameter.sets)
    )
    return _of_sets(sets) if sets[0] else None


def _distribution_element(path: Path | str, files: XmlFiles | None) -> Any:
    root = (files or XmlFiles()).root(Path(path))
    element = root.find("ParameterValueDistribution")
    if element is None:
        location = place_of(root, str(path))
        raise InputError(f"{location}: <{root.tag}> has no <ParameterValueDistribution>; `space` takes such a file.")
    return element


def _read_value_sets(element: Any, path: str) -> Parameter:
    """Read parameters that vary together, as one parameter with a choice for each set."""
    sets = []
    for value_set in element.iterfind("ValueSetDistribution/ParameterValueSet"):
        members = [(e.get("parameterRef", "").lstrip("$"), e.get("value", "")) for e in value_set.iterchildren("*")]
        sets.append(tuple(sorted(members)))
    names = [name for name, _ in sets[0]] if sets else []
    if not names or any([name for name, _ in members] != names for members in sets):
        raise InputError(
            f"{path}: each <ParameterValueSet> of a distribution must set the same parameters, at least one."
        )
    return _of_sets(tuple(dict.fromkeys(sets)))


def _of_sets(sets: tuple[tuple[tuple[str, str], ...], ...]) -> Parameter:
    # Label sets by the members that differ.
    differing = [k for k in range(len(sets[0])) if len({members[k] for members in sets}) > 1] or [0]
    labels = tuple(", ".join(members[k][1] for k in differing) for members in sets)
    if len(set(labels)) < len(labels):
        labels = tuple(f"{k + 1}: {label}" for k, label in enumerate(labels))
    name = ", ".join(sets[0][k][0] for k in differing)
    return Parameter(name, 0.0, len(sets) - 1.0, None, labels, sets=sets)


def _read_deterministic(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    where = f"{path}, parameter {name}"
    span, choice_set = element.find("DistributionRange"), element.find("DistributionSet")
    if span is not None:
        bounds = span.find("Range")
        if bounds is None:
            raise InputError(f"{where}: <DistributionRange> has no <Range>.")
        low, high, step = (
            _number(text, where) for text in (bounds.get("lowerLimit"), bounds.get("upperLimit"), span.get("stepWidth"))
        )
        return ranged(name, low, high, step, where)
    if choice_set is not None:
        choices = tuple(dict.fromkeys(e.get("value", "") for e in choice_set.iterfind("Element")))
        if not choices:
            raise InputError(f"{where}: <DistributionSet> is empty.")
        return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
    raise InputError(f"{where}: only ranges and sets are read; a user-defined distribution is not.")


def _read_stochastic(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    law, choices = read_distribution(element, path)
    step = 1.0 if law.kind == "poisson" else None
    return Parameter(name, law.low, law.high, step, choices, distribution=law)


def _number(text: str | None, where: str) -> float:
    try:
        return number_of(text or "")
    except ValueError:
        raise InputError(f"{where}: '{text}' is not a number.") from None


_DISTRIBUTIONS: Final[Mapping[str, Callable[[Any, str], Parameter]]] = {
    "DeterministicMultiParameterDistribution": _read_value_sets,
    "DeterministicSingleParameterDistribution": _read_deterministic,
    "StochasticDistribution": _read_stochastic,
}


def _with_unit(parameter: Parameter, distribution: Any) -> Parameter:
    """Set the unit from a property of the file that is named ``unit of NAME``."""
    properties = unrecorded(distribution.getparent(), "FileHeader", "Properties", "Property")
    item = named(properties, f"unit of {parameter.name}")
    return parameter if item is None else replace(parameter, unit=item.get("value", ""))
