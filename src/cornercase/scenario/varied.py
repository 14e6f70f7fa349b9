"""What is varied, as texts and files say it: ``NAME=LOW:HIGH[:STEP]`` and OpenSCENARIO's parameter distributions."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.numbers import number_of
from cornercase._common.places import place_of, placed
from cornercase._common.recorded_xml import named, unrecorded
from cornercase.scenario.distributions import read_distribution
from cornercase.scenario.parameter import Parameter
from cornercase.scenario.xml import XmlFiles

# Beyond these, ranges and steps have no digits left.
_LARGEST = 1e15
_MOST_STEPS = 1e9
_RANGE = re.compile(r"(?P<name>[^=]+)=(?P<low>[^:]+):(?P<high>[^:]+)(?::(?P<step>[^:]+))?")


def read_ranges(texts: Sequence[str], given: str = "ranges") -> list[Parameter]:
    """Read ``NAME=LOW:HIGH[:STEP]`` texts.

    Parameters
    ----------
    texts : sequence of str
    given : str
        Parameter that they were given for.

    Returns
    -------
    list of Parameter

    Raises
    ------
    InputError
        A text is malformed, a bound is not finite, or LOW is not below HIGH.
    """
    parameters = [_read_range(text, f"`{given}` {text}") for text in texts]
    _require_names([parameter.name for parameter in parameters], f"`{given}`")
    return parameters


def read_distribution_file(path: Path | str, files: XmlFiles | None = None) -> list[Parameter]:
    """Read an OpenSCENARIO ParameterValueDistribution file.

    Parameters
    ----------
    path : path
    files : XmlFiles, optional
        Keeps it, and what was read of it.

    Returns
    -------
    list of Parameter

    Raises
    ------
    InputError
        The file cannot be used; the message names the parameter.
    """
    distribution = _distribution_element(path, files)
    parameters = []
    for tag, read in _DISTRIBUTIONS.items():
        for element in distribution.iterfind(f".//{tag}"):
            with placed(element, str(path)):
                parameters.append(read(element, str(path)))
    with placed(distribution, str(path)):
        if not parameters:
            raise InputError(f"{path}: varies no parameter.")
        _require_names([name for p in parameters for name in p.assigns], str(path))
    return [_with_unit(parameter, distribution) for parameter in parameters]


def scenario_file_of(path: Path | str, files: XmlFiles | None = None) -> Path:
    """Scenario that a ParameterValueDistribution file belongs to.

    Parameters
    ----------
    path : path
    files : XmlFiles, optional
        Keeps it, and what was read of it.

    Returns
    -------
    Path

    Raises
    ------
    InputError
        It names none on this machine.
    """
    file = _distribution_element(path, files).find("ScenarioFile")
    name = "" if file is None else file.get("filepath", "")
    if not name or re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name):
        place = str(path) if file is None else place_of(file, str(path))
        raise InputError(f"{place}: <ScenarioFile> must name a local file.")
    return Path(path).parent / name


def without(parameter: Parameter, names: set[str]) -> Parameter | None:
    """Parameter without those of its members that are varied by themselves.

    Parameters
    ----------
    parameter : Parameter
    names : set of str
        Parameters of the scenario that are varied by themselves.

    Returns
    -------
    Parameter or None
        None where nothing is left.
    """
    if not parameter.sets:
        return parameter
    sets = tuple(
        dict.fromkeys(tuple(member for member in members if member[0] not in names) for members in parameter.sets)
    )
    return _of_sets(sets) if sets[0] else None


def _read_value_sets(element: Any, path: str) -> Parameter:
    """Parameters whose values go together, as one with a choice for each set."""
    sets = []
    for one in element.iterfind("ValueSetDistribution/ParameterValueSet"):
        members = [(e.get("parameterRef", "").lstrip("$"), e.get("value", "")) for e in one.iterchildren("*")]
        sets.append(tuple(sorted(members)))
    names = [name for name, _ in sets[0]] if sets else []
    if not names or any([name for name, _ in members] != names for members in sets):
        raise InputError(
            f"{path}: each <ParameterValueSet> of a distribution must set the same parameters, at least one."
        )
    return _of_sets(tuple(dict.fromkeys(sets)))


def _of_sets(sets: tuple[tuple[tuple[str, str], ...], ...]) -> Parameter:
    # What is the same in all sets says nothing about one of them.
    telling = [k for k in range(len(sets[0])) if len({members[k] for members in sets}) > 1] or [0]
    labels = tuple(", ".join(members[k][1] for k in telling) for members in sets)
    if len(set(labels)) < len(labels):
        labels = tuple(f"{k + 1}: {label}" for k, label in enumerate(labels))
    name = ", ".join(sets[0][k][0] for k in telling)
    return Parameter(name, 0.0, len(sets) - 1.0, None, labels, sets=sets)


def _read_range(text: str, where: str) -> Parameter:
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        raise InputError(f"{where}: write it as NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
    numbers = {}
    for key in ("low", "high", "step"):
        if match[key] is not None:
            try:
                numbers[key] = number_of(match[key])
            except ValueError:
                raise InputError(f"{where}: '{match[key]}' is not a number.") from None
    return _ranged(match["name"].strip(), numbers["low"], numbers["high"], numbers.get("step"), where)


def _ranged(name: str, low: float, high: float, step: float | None, where: str) -> Parameter:
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError(f"{where}: the bounds of {name} must be finite.")
    if max(abs(low), abs(high)) > _LARGEST:
        raise InputError(f"{where}: the bounds of {name} are {low:g} and {high:g}; at most {_LARGEST:g} is searched.")
    if low >= high:
        raise InputError(
            f"{where}: the range of {name} is {low:g} to {high:g}; the lower bound must be below the upper."
        )
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"{where}: the step of {name} must be above 0 and at most {high - low:g}.")
    if step is not None and (high - low) / step > _MOST_STEPS:
        raise InputError(
            f"{where}: the range of {name} has {(high - low) / step:.3g} steps; at most {_MOST_STEPS:g} are searched,"
            " or the range without steps."
        )
    return Parameter(name, low, high, step)


def _require_names(names: Sequence[str], where: str) -> None:
    for name in names:
        if not name:
            raise InputError(f"{where}: a varied parameter has no name.")
        if names.count(name) > 1:
            raise InputError(f"{where}: the parameter {name} is varied twice; keep one of them.")


def _distribution_element(path: Path | str, files: XmlFiles | None) -> Any:
    root = (files or XmlFiles()).root(Path(path))
    element = root.find("ParameterValueDistribution")
    if element is None:
        place = place_of(root, str(path))
        raise InputError(f"{place}: <{root.tag}> has no <ParameterValueDistribution>; `space` takes such a file.")
    return element


def _read_deterministic(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    where = f"{path}, parameter {name}"
    span, some = element.find("DistributionRange"), element.find("DistributionSet")
    if span is not None:
        bounds = span.find("Range")
        if bounds is None:
            raise InputError(f"{where}: <DistributionRange> has no <Range>.")
        low, high, step = (
            _number(text, where) for text in (bounds.get("lowerLimit"), bounds.get("upperLimit"), span.get("stepWidth"))
        )
        return _ranged(name, low, high, step, where)
    if some is not None:
        choices = tuple(dict.fromkeys(e.get("value", "") for e in some.iterfind("Element")))
        if not choices:
            raise InputError(f"{where}: <DistributionSet> is empty.")
        return Parameter(name, 0.0, len(choices) - 1.0, None, choices)
    raise InputError(f"{where}: only ranges and sets are read; a user-defined distribution is not.")


def _read_stochastic(element: Any, path: str) -> Parameter:
    name = element.get("parameterName", "")
    law, choices = read_distribution(element, path)
    step = 1.0 if law.kind == "poisson" else None
    return Parameter(name, law.low, law.high, step, choices, distribution=law)


_DISTRIBUTIONS: Final[Mapping[str, Callable[[Any, str], Parameter]]] = {
    "DeterministicMultiParameterDistribution": _read_value_sets,
    "DeterministicSingleParameterDistribution": _read_deterministic,
    "StochasticDistribution": _read_stochastic,
}


def _with_unit(parameter: Parameter, distribution: Any) -> Parameter:
    """Take the unit from a property of the file named ``unit of NAME``."""
    properties = unrecorded(distribution.getparent(), "FileHeader", "Properties", "Property")
    item = named(properties, f"unit of {parameter.name}")
    return parameter if item is None else replace(parameter, unit=item.get("value", ""))


def _number(text: str | None, where: str) -> float:
    try:
        return number_of(text or "")
    except ValueError:
        raise InputError(f"{where}: '{text}' is not a number.") from None
