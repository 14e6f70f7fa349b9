"""Parameter spaces: what is varied, and the unit cube that optimizers see."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray, IntArray
from cornercase.scenario.distributions import Distribution, from_json, read_distribution
from cornercase.scenario.xml import read_xml

Value = float | str

# So many points are looked at to see whether constraints leave anything.
_SAMPLED = 2048

_RANGE = re.compile(r"(?P<name>[^=]+)=(?P<low>[^:]+):(?P<high>[^:]+)(?::(?P<step>[^:]+))?")


@dataclass(frozen=True)
class Parameter:
    """One varied parameter.

    Attributes
    ----------
    name : str
    low, high : float
        Bounds; for a set of choices 0 and their number minus one.
    step : float or None
        Values lie on low, low + step, …, none above `high`; None for a continuous range.
    choices : tuple of str
        Values of a set; empty for a range.
    unit : str
        As it stands in tables and on axes; empty where unknown.
    distribution : Distribution or None
        Turns the unit interval into values by its inverse distribution function, so that a likely value has a large
        share of it; None means uniform.
    sets : tuple of tuple of (str, str)
        For each choice, the scenario's parameters that it sets together, and their values; empty where it sets but the
        one of its own name.
    """

    name: str
    low: float
    high: float
    step: float | None = None
    choices: tuple[str, ...] = ()
    unit: str = ""
    distribution: Distribution | None = None
    sets: tuple[tuple[tuple[str, str], ...], ...] = ()

    @property
    def size(self) -> int | None:
        """Number of different values; None where there are infinitely many."""
        if self.choices:
            return len(self.choices)
        return None if self.step is None else int(np.floor((self.high - self.low) / self.step + 1e-9)) + 1

    @property
    def assigns(self) -> tuple[str, ...]:
        """Names of the scenario's parameters that it gives values to."""
        return tuple(dict(self.sets[0])) if self.sets else (self.name,)

    def assigned(self, u: float) -> dict[str, Value]:
        """Parameters of the scenario, and their values, at a place of the unit interval."""
        if not self.sets:
            return {self.name: self.value(u)}
        (k,) = self.numbers(np.array([u])).tolist()
        return dict(self.sets[k])

    def read(self, values: Mapping[str, Value]) -> Value:
        """Value among those of a concrete scenario; for values set together, the choice that they are."""
        if not self.sets:
            return values[self.name]
        for choice, members in zip(self.choices, self.sets, strict=True):
            if all(str(values.get(name)) == value for name, value in members):
                return choice
        raise InputError(f"No value set of {self.name} has these values.")

    def value(self, u: float) -> Value:
        """Value at a place of the unit interval."""
        if self.size is None:
            x = self.low + u * (self.high - self.low)
            return float(x if self.distribution is None else self.distribution.quantile(u))
        (k,) = self.numbers(np.array([u])).tolist()
        return self.choices[k] if self.choices else _clean(self.low + k * float(self.step or 0.0))

    def unit_place(self, value: Value) -> float:
        """Place on the unit interval of a value: the middle of its step or choice."""
        size = self.size
        if self.choices:
            if str(value) not in self.choices:
                raise InputError(f"The parameter {self.name} has no value '{value}'.")
            return float(self.middles(np.array([self.choices.index(str(value))]))[0])
        x = float(value)
        if size is not None:
            k = round((x - self.low) / float(self.step or 1.0))
            return float(self.middles(np.array([min(max(k, 0), size - 1)]))[0])
        if self.distribution is not None:
            return self.distribution.place(x)
        return float(np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0))

    def numbers(self, u: FloatArray) -> IntArray:
        """Which step or choice, from 0 on, lies at each place of the unit interval, shape (n,)."""
        if self._edges is not None:
            return np.asarray(np.searchsorted(self._edges[1:-1], u, side="right"), dtype=np.int64)
        size = self.size or 1
        return np.asarray(np.minimum(np.floor(u * size), size - 1), dtype=np.int64)

    def middles(self, numbers: IntArray) -> FloatArray:
        """Middle of the share that a step or choice has of the unit interval, shape (n,)."""
        if self._edges is not None:
            return np.asarray(0.5 * (self._edges[numbers] + self._edges[numbers + 1]))
        return np.asarray((numbers + 0.5) / (self.size or 1))

    @cached_property
    def _edges(self) -> FloatArray | None:
        """Bounds of the shares where they differ."""
        return None if self.size is None or self.distribution is None else self.distribution.edges()


class ParameterSpace:
    """A named box of parameters.

    Parameters
    ----------
    parameters : sequence of Parameter
        At least one; no name twice.
    admits : callable, optional
        Points, shape (n, d), to whether each stands for a scenario that may be, shape (n,); by default all do.
    """

    def __init__(
        self, parameters: Sequence[Parameter], admits: Callable[[FloatArray], BoolArray] | None = None
    ) -> None:
        self.parameters = tuple(parameters)
        self._admits = admits
        if not self.parameters:
            raise InputError("The parameter space is empty; vary at least one parameter.")
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(f"The parameter {name} is varied twice.")

    def __eq__(self, other: object) -> bool:
        return isinstance(other, ParameterSpace) and self.parameters == other.parameters

    def __hash__(self) -> int:
        return hash(self.parameters)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def assigns(self) -> tuple[str, ...]:
        """Names of all parameters of the scenario that a point gives values to."""
        return tuple(name for parameter in self.parameters for name in parameter.assigns)

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def size(self) -> int | None:
        """Number of concrete scenarios; None where there are infinitely many."""
        product = 1
        for parameter in self.parameters:
            if parameter.size is None:
                return None
            product *= parameter.size
        return product

    @classmethod
    def from_ranges(cls, ranges: Sequence[str]) -> ParameterSpace:
        """Space of ``NAME=LOW:HIGH[:STEP]`` texts.

        Parameters
        ----------
        ranges : sequence of str
            One for each parameter.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            A text is malformed, a bound is not finite, or LOW is not below HIGH.

        Examples
        --------
        >>> from cornercase import ParameterSpace
        >>> space = ParameterSpace.from_ranges(["speed=10:20", "lanes=1:3:1"])
        >>> space.values([[0.5, 0.9]])
        [{'speed': 15.0, 'lanes': 3.0}]
        """
        parameters = [_parse_range(text) for text in ranges]
        _require_names([parameter.name for parameter in parameters], "--range")
        return cls(parameters)

    @classmethod
    def from_file(cls, path: Path | str) -> ParameterSpace:
        """Space of an OpenSCENARIO ParameterValueDistribution file.

        Raises
        ------
        InputError
            The file cannot be used; the message names the parameter.
        """
        distribution = _distribution_element(path)
        parameters = []
        for element in distribution.iterfind(".//DeterministicMultiParameterDistribution"):
            parameters.append(_value_sets(element, str(path)))
        for element in distribution.iterfind(".//DeterministicSingleParameterDistribution"):
            parameters.append(_deterministic(element, str(path)))
        for element in distribution.iterfind(".//StochasticDistribution"):
            name = element.get("parameterName", "")
            law, choices = read_distribution(element, str(path))
            step = 1.0 if law.kind == "poisson" else None
            parameters.append(Parameter(name, law.low, law.high, step, choices, distribution=law))
        if not parameters:
            raise InputError(f"{path}: varies no parameter.")
        _require_names([name for p in parameters for name in p.assigns], str(path))
        return cls([_with_unit(parameter, distribution) for parameter in parameters])

    @staticmethod
    def scenario_file(path: Path | str) -> Path:
        """Scenario that a ParameterValueDistribution file belongs to."""
        file = _distribution_element(path).find("ScenarioFile")
        name = "" if file is None else file.get("filepath", "")
        if not name or re.match(r"[A-Za-z][A-Za-z0-9+.-]+:", name):
            raise InputError(f"{path}: <ScenarioFile> must name a local file.")
        return Path(path).parent / name

    def with_ranges(self, ranges: Sequence[str]) -> ParameterSpace:
        """Space with parameters added, or replaced where the name is the same."""
        new = ParameterSpace.from_ranges(ranges).parameters if ranges else ()
        kept = [_without(parameter, {one.name for one in new}) for parameter in self.parameters]
        merged = {parameter.name: parameter for parameter in kept if parameter is not None}
        for parameter in new:
            before = merged.get(parameter.name)
            merged[parameter.name] = parameter if before is None else replace(parameter, unit=before.unit)
        return ParameterSpace(list(merged.values()))

    def continuous(self) -> ParameterSpace:
        """Space in which ranges with steps are intervals."""
        return ParameterSpace([replace(one, step=None) if not one.choices else one for one in self.parameters])

    def limited(self, admits: Callable[[FloatArray], BoolArray]) -> ParameterSpace:
        """Space without what `admits` does not admit.

        Raises
        ------
        InputError
            Hardly anything would be left of it.
        """
        space = ParameterSpace(self.parameters, admits)
        few = self.size is not None and self.size <= _SAMPLED
        some = self.lattice() if few else np.random.default_rng(0).random((_SAMPLED, self.dimension))
        if not space.admits(self.snap(some)).any():
            raise InputError(
                f"None of {len(some)} concrete scenarios fulfils the constraints of the scenario's parameters; vary"
                " them within their constraints."
            )
        return space

    def admits(self, points: FloatArray) -> BoolArray:
        """Whether points stand for scenarios that may be, shape (n,)."""
        if self._admits is None or len(points) == 0:
            return np.ones(len(points), dtype=np.bool_)
        return self._admits(points)

    def values(self, points: FloatArray) -> list[dict[str, Value]]:
        """Values at points of the unit cube, shape (n, d)."""
        return [
            {
                name: value
                for parameter, u in zip(self.parameters, point, strict=True)
                for name, value in parameter.assigned(float(u)).items()
            }
            for point in np.clip(points, 0.0, 1.0)
        ]

    def points(self, values: Sequence[Mapping[str, Value]]) -> FloatArray:
        """Points of the unit cube of values, shape (n, d)."""
        return np.array(
            [[parameter.unit_place(parameter.read(one)) for parameter in self.parameters] for one in values]
        ).reshape(-1, self.dimension)

    def middle(self) -> FloatArray:
        """Point in the middle of the space that it admits, shape (1, d)."""
        points = np.concatenate(
            [np.full((1, self.dimension), 0.5), np.random.default_rng(0).random((_SAMPLED, self.dimension))]
        )
        points = self.snap(points)
        return points[self.admits(points)][:1]

    def snap(self, points: FloatArray) -> FloatArray:
        """Points of what is really run, shape (n, d): the middle of each step or choice."""
        snapped = np.clip(np.asarray(points, dtype=np.float64), 0.0, 1.0).copy()
        for j, parameter in enumerate(self.parameters):
            if parameter.size is not None:
                snapped[:, j] = parameter.middles(parameter.numbers(snapped[:, j]))
        return snapped

    def lattice(self, steps: Sequence[int] | None = None) -> FloatArray:
        """Points of a full factorial design, shape (n, d); the last parameter varies fastest.

        Parameters
        ----------
        steps : sequence of int, length d, optional
            How many values of each parameter, evenly apart; by default all, which needs a finite space.
        """
        axes = []
        for j, parameter in enumerate(self.parameters):
            size = parameter.size
            count = steps[j] if steps is not None else int(size or 1)
            places = (np.arange(count) + 0.5) / count
            # A likely value may have several places on the unit interval, but is one value.
            axes.append(places if size is None else parameter.middles((places * size).astype(np.int64)))
        return np.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.dimension))

    def to_json(self) -> list[dict[str, Any]]:
        """Plain values from which `from_json` makes the same space."""
        return [
            {
                "name": p.name,
                "low": p.low,
                "high": p.high,
                "step": p.step,
                "choices": list(p.choices),
                "unit": p.unit,
                "distribution": None if p.distribution is None else p.distribution.to_json(),
                "sets": [dict(members) for members in p.sets],
            }
            for p in self.parameters
        ]

    @classmethod
    def from_json(cls, plain: Sequence[Mapping[str, Any]]) -> ParameterSpace:
        """Space from `to_json`."""
        return cls(
            [
                Parameter(
                    p["name"],
                    p["low"],
                    p["high"],
                    p["step"],
                    tuple(p["choices"]),
                    p["unit"],
                    None if p["distribution"] is None else from_json(p["distribution"]),
                    tuple(tuple(members.items()) for members in p.get("sets", ())),
                )
                for p in plain
            ]
        )


def _value_sets(element: Any, path: str) -> Parameter:
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


def _without(parameter: Parameter, names: set[str]) -> Parameter | None:
    """Parameter without those of its members that are varied by themselves; None where nothing is left."""
    if not parameter.sets:
        return parameter
    sets = tuple(
        dict.fromkeys(tuple(member for member in members if member[0] not in names) for members in parameter.sets)
    )
    return _of_sets(sets) if sets[0] else None


def _parse_range(text: str) -> Parameter:
    match = _RANGE.fullmatch(text.strip())
    if match is None:
        raise InputError(f"--range {text}: write it as NAME=LOW:HIGH or NAME=LOW:HIGH:STEP.")
    numbers = {}
    for key in ("low", "high", "step"):
        if match[key] is not None:
            try:
                numbers[key] = float(match[key])
            except ValueError:
                raise InputError(f"--range {text}: '{match[key]}' is not a number.") from None
    return _ranged(match["name"].strip(), numbers["low"], numbers["high"], numbers.get("step"), f"--range {text}")


def _ranged(name: str, low: float, high: float, step: float | None, where: str) -> Parameter:
    if not (np.isfinite(low) and np.isfinite(high)):
        raise InputError(f"{where}: the bounds of {name} must be finite.")
    if low >= high:
        raise InputError(
            f"{where}: the range of {name} is {low:g} to {high:g}; the lower bound must be below the upper."
        )
    if step is not None and not 0 < step <= high - low:
        raise InputError(f"{where}: the step of {name} must be above 0 and at most {high - low:g}.")
    return Parameter(name, low, high, step)


def _require_names(names: Sequence[str], where: str) -> None:
    for name in names:
        if not name:
            raise InputError(f"{where}: a varied parameter has no name.")
        if names.count(name) > 1:
            raise InputError(f"{where}: the parameter {name} is varied twice; keep one of them.")


def _distribution_element(path: Path | str) -> Any:
    element = read_xml(path).find("ParameterValueDistribution")
    if element is None:
        raise InputError(f"{path}: has no <ParameterValueDistribution>; --space takes such a file.")
    return element


def _deterministic(element: Any, path: str) -> Parameter:
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


def _with_unit(parameter: Parameter, distribution: Any) -> Parameter:
    """Take the unit from a property of the file named ``unit of NAME``."""
    for item in distribution.getroottree().iterfind("FileHeader/Properties/Property"):
        if item.get("name") == f"unit of {parameter.name}":
            return replace(parameter, unit=item.get("value", ""))
    return parameter


def _number(text: str | None, where: str) -> float:
    try:
        return float(text or "")
    except ValueError:
        raise InputError(f"{where}: '{text}' is not a number.") from None


def _clean(x: float) -> float:
    """Round away what adding steps leaves behind, so that 3 × 0.1 is 0.3."""
    return float(f"{x:.12g}")
