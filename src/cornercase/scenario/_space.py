"""Parameter spaces: the varied parameters, and the unit cube that optimizers search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any, Self

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import BoolArray, FloatArray
from cornercase.scenario import _constraints as constraints
from cornercase.scenario import _distributions as distributions
from cornercase.scenario._constraints import ParameterDeclaration, format_constraints
from cornercase.scenario._distribution_files import read_distribution_file, read_scenario_path, remove_from_value_sets
from cornercase.scenario._parameter import Parameter, Value
from cornercase.scenario._range_syntax import format_ranges, parse_ranges
from cornercase.scenario._scope import fulfils_constraints
from cornercase.scenario._types import convert_parameter_to_type
from cornercase.scenario._xml import XmlFileCache

# Number of points to test constraints with.
_N_TEST_POINTS = 2048


class ParameterSpace:
    """A box of named parameters, possibly restricted by constraints.

    A point of the unit cube stands for a concrete scenario: each coordinate is the position of a parameter's value in
    the unit interval, see `Parameter`.

    Parameters
    ----------
    parameters : sequence of Parameter
        With different names. Without parameters, nothing is varied or searched.
    declarations : sequence of ParameterDeclaration
        Declared parameters of the scenario. The space is limited to the values that fulfil their constraints.

    Raises
    ------
    InputError
        Two parameters have the same name.

    Examples
    --------
    >>> import numpy as np
    >>> import cornercase as cc
    >>> space = cc.ParameterSpace.from_ranges(["speed=5:15", "gap=0:40:2"])
    >>> space
    <ParameterSpace: speed 5 to 15, gap 0 to 40 by 2>
    >>> space.values(np.array([[0.5, 0.25]]))
    [{'speed': 10.0, 'gap': 10.0}]
    """

    def __init__(self, parameters: Sequence[Parameter], declarations: Sequence[ParameterDeclaration] = ()) -> None:
        self.parameters = tuple(parameters)
        self.declarations = tuple(declarations)
        for name in self.names:
            if self.names.count(name) > 1:
                raise InputError(f"The parameter {name} is varied twice.")

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, ParameterSpace):
            return NotImplemented
        return (self.parameters, self.declarations) == (other.parameters, other.declarations)

    def __hash__(self) -> int:
        return hash((self.parameters, self.declarations))

    def __repr__(self) -> str:
        constrained = [declaration.name for declaration in self.declarations if declaration.constraint_groups]
        suffix = f", {', '.join(constrained)} constrained" if constrained else ""
        return f"<ParameterSpace: {', '.join(map(str, self.parameters))}{suffix}>"

    def _repr_html_(self) -> str:
        """Return a table of the parameters, for notebooks."""
        groups = {declaration.name: declaration.constraint_groups for declaration in self.declarations}
        lines = [
            (p.name, p.values_text, p.unit, "uniform" if p.distribution is None else p.distribution.kind,
             " or ".join(map(format_constraints, groups.get(p.name, ()))))
            for p in self.parameters
        ]  # fmt: skip
        head = "".join(f"<th>{name}</th>" for name in ("parameter", "values", "unit", "distribution", "constraints"))
        body = "".join("<tr>" + "".join(f"<td>{escape(text)}</td>" for text in line) + "</tr>" for line in lines)
        return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"

    def require_parameters(self) -> Self:
        """Return the space itself if it has parameters; otherwise raise an error.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            The space has no parameters.
        """
        if not self.parameters:
            raise InputError("The parameter space is empty; vary at least one parameter.")
        return self

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters, in order."""
        return tuple(parameter.name for parameter in self.parameters)

    @property
    def assigned_names(self) -> tuple[str, ...]:
        """Names of all scenario parameters that a point of the space sets."""
        return tuple(name for parameter in self.parameters for name in parameter.assigned_names)

    @property
    def dimension(self) -> int:
        """Number of parameters."""
        return len(self.parameters)

    @property
    def size(self) -> int | None:
        """Number of concrete scenarios, including those that violate constraints; None if infinite."""
        product = 1
        for parameter in self.parameters:
            if parameter.size is None:
                return None
            product *= parameter.size
        return product

    @classmethod
    def from_ranges(cls, ranges: Sequence[str] | Mapping[str, Sequence[float]]) -> ParameterSpace:
        """Create a space from ranges.

        Parameters
        ----------
        ranges : sequence of str or mapping
            ``["NAME=LOW:HIGH[:STEP]"]`` or ``{"NAME": (LOW, HIGH)}``, with the step as third number.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            `ranges` is empty, a text is malformed, a bound is not finite, or LOW is not below HIGH.

        Examples
        --------
        >>> from cornercase import ParameterSpace
        >>> space = ParameterSpace.from_ranges(["speed=10:20", "lanes=1:3:1"])
        >>> space.values([[0.5, 0.9]])
        [{'speed': 15.0, 'lanes': 3.0}]
        """
        return cls(parse_ranges(format_ranges(ranges))).require_parameters()

    @classmethod
    def from_file(cls, path: Path | str, cache: XmlFileCache | None = None) -> ParameterSpace:
        """Read the space of an OpenSCENARIO ParameterValueDistribution file.

        Parameters
        ----------
        path : path
        cache : XmlFileCache, optional
            Cache of parsed files.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            The file cannot be used; the message names the parameter.
        """
        return cls(read_distribution_file(path, cache))

    @staticmethod
    def read_scenario_path(path: Path | str, cache: XmlFileCache | None = None) -> Path:
        """Return the path of the scenario file that a ParameterValueDistribution file belongs to.

        Parameters
        ----------
        path : path
        cache : XmlFileCache, optional
            Cache of parsed files.

        Returns
        -------
        Path

        Raises
        ------
        InputError
            The file cannot be used, or names no scenario.
        """
        return read_scenario_path(path, cache)

    def with_ranges(self, ranges: Sequence[str]) -> ParameterSpace:
        """Return the space with ranges added; a range replaces a parameter of the same name.

        Parameters
        ----------
        ranges : sequence of str
            ``NAME=LOW:HIGH[:STEP]``.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            A text is malformed, a bound is not finite, or LOW is not below HIGH.
        """
        return self.with_parameters(parse_ranges(ranges))

    def with_parameters(self, added: Sequence[Parameter]) -> ParameterSpace:
        """Return the space with parameters added.

        An added parameter replaces a parameter of the same name, and takes over its unit.

        Parameters
        ----------
        added : sequence of Parameter

        Returns
        -------
        ParameterSpace
        """
        remaining = [
            remove_from_value_sets(parameter, {addition.name for addition in added}) for parameter in self.parameters
        ]
        merged = {parameter.name: parameter for parameter in remaining if parameter is not None}
        for parameter in added:
            replaced = merged.get(parameter.name)
            merged[parameter.name] = parameter if replaced is None else replace(parameter, unit=replaced.unit)
        return ParameterSpace(list(merged.values()), self.declarations)

    def as_continuous(self) -> ParameterSpace:
        """Return the space without steps: ranges become continuous.

        Parameters with one value, with choices or with a discrete distribution stay as they are.

        Returns
        -------
        ParameterSpace
        """
        parameters = [
            replace(parameter, step=None)
            if parameter.low < parameter.high and not parameter.choices and not _has_discrete_distribution(parameter)
            else parameter
            for parameter in self.parameters
        ]
        return ParameterSpace(parameters, self.declarations)

    def with_types(
        self, declarations: Sequence[ParameterDeclaration], file_name: str = "the scenario"
    ) -> ParameterSpace:
        """Return the space with values converted to the types that a scenario declares.

        Parameters
        ----------
        declarations : sequence of ParameterDeclaration
            All declared parameters of the scenario.
        file_name : str
            Name of the file, for messages.

        Returns
        -------
        ParameterSpace
            Integer parameters get integer steps. Boolean parameters get the choices false and true.

        Raises
        ------
        InputError
            A range does not fit its type.
        """
        kinds = {declaration.name: declaration.type_name for declaration in declarations}
        parameters = [convert_parameter_to_type(p, kinds.get(p.name, "double"), file_name) for p in self.parameters]
        return ParameterSpace(parameters, self.declarations)

    def with_constraints(
        self, declarations: Sequence[ParameterDeclaration], file_name: str = "the scenario"
    ) -> ParameterSpace:
        """Return the space restricted to the constraints of a scenario's parameters.

        Parameters
        ----------
        declarations : sequence of ParameterDeclaration
            All declared parameters of the scenario.
        file_name : str
            Name of the file, for messages.

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            No tested point fulfils the constraints. In a space of at most 2048 points, all points are tested,
            otherwise 2048 random points.
        """
        if not self.parameters or not any(declaration.constraint_groups for declaration in declarations):
            return ParameterSpace(self.parameters)
        points = self._constraint_test_points()
        if not fulfils_constraints(declarations, self.values(self.snap(points)), file_name).any():
            raise InputError(
                f"None of {len(points)} concrete scenarios fulfils the constraints of the scenario's parameters; vary"
                " the parameters within their constraints."
            )
        return ParameterSpace(self.parameters, declarations)

    def is_admissible(self, points: FloatArray) -> BoolArray:
        """Return a mask of the points that fulfil the constraints.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Points of the unit cube, with one coordinate for each parameter.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        if not self.declarations or len(points) == 0:
            return np.ones(len(points), dtype=np.bool_)
        return fulfils_constraints(self.declarations, self.values(points))

    def values(self, points: FloatArray) -> list[dict[str, Value]]:
        """Return the parameter values of points in the unit cube.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            One coordinate for each parameter. Coordinates are clipped to 0 to 1.

        Returns
        -------
        list of dict of str to float or str, length n
        """
        # By column for speed: with constraints, a search tests 100,000 points.
        columns: dict[str, list[Value]] = {}
        if len(points):
            for parameter, u in zip(self.parameters, np.clip(points, 0.0, 1.0).T, strict=True):
                columns |= parameter.assignments_at(u)
        if not columns:
            return [{} for _ in points]
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    def points(self, values: Sequence[Mapping[str, Value]]) -> FloatArray:
        """Return the points of the unit cube that stand for parameter values, the inverse of `values`.

        Parameters
        ----------
        values : sequence of mapping of str to float or str, length n

        Returns
        -------
        ndarray of float64, shape (n, d)
            One coordinate for each parameter.

        Raises
        ------
        InputError
            A value is none of the choices of its parameter.
        """
        return np.array(
            [
                [parameter.unit_position(parameter.extract_value(scenario)) for parameter in self.parameters]
                for scenario in values
            ]
        ).reshape(-1, self.dimension)

    def center_point(self) -> FloatArray:
        """Return the center of the space, or another admissible point if the center violates the constraints.

        In a space of at most 2048 points, the other point is the first admissible point of `full_factorial`, otherwise
        a random point.

        Returns
        -------
        ndarray of float64, shape (1, d)
            One coordinate for each parameter.
        """
        points = self.snap(np.concatenate([np.full((1, self.dimension), 0.5), self._constraint_test_points()]))
        return points[self.is_admissible(points)][:1]

    def representative_points(self) -> FloatArray:
        """Return the center point, and a few more points, so that each choice of each parameter occurs.

        Points that violate the constraints are left out.

        Returns
        -------
        ndarray of float64, shape (n, d)
            The first point is `center_point`. Each point has one coordinate for each parameter.
        """
        count = max(len(parameter.choices) for parameter in self.parameters)
        points = np.full((max(count, 1), self.dimension), 0.5)
        for j, parameter in enumerate(self.parameters):
            if parameter.choices:
                points[:, j] = parameter.level_midpoints(np.arange(len(points)) % len(parameter.choices))
        points = self.snap(points)
        return np.concatenate([self.center_point(), points[self.is_admissible(points)]])

    def _constraint_test_points(self) -> FloatArray:
        """Return points to test constraints at: all points of a small space, or random points of a larger one."""
        few = self.size is not None and self.size <= _N_TEST_POINTS
        return self.full_factorial() if few else np.random.default_rng(0).random((_N_TEST_POINTS, self.dimension))

    def snap(self, points: FloatArray) -> FloatArray:
        """Move each coordinate to the middle of the part of the unit interval that its step or choice covers.

        Coordinates of continuous ranges are only clipped to the unit interval.

        Parameters
        ----------
        points : array_like of float, shape (n, d)
            Points of the unit cube, with one coordinate for each parameter.

        Returns
        -------
        ndarray of float64, shape (n, d)
        """
        snapped = np.clip(np.asarray(points, dtype=np.float64), 0.0, 1.0).copy()
        for j, parameter in enumerate(self.parameters):
            if parameter.size is not None:
                snapped[:, j] = parameter.level_midpoints(parameter.level_indices(snapped[:, j]))
        return snapped

    def full_factorial(self, n_levels: Sequence[int] | None = None) -> FloatArray:
        """Return the points of a full factorial design.

        Parameters
        ----------
        n_levels : sequence of int, length d, optional
            Number of evenly spaced values of each parameter. By default, a parameter has all of its values; a
            continuous parameter has only one value, at the middle of the unit interval.

        Returns
        -------
        ndarray of float64, shape (n, d)
            Points of the unit cube, with one coordinate for each parameter. The last parameter varies fastest.
        """
        axes = []
        for j, parameter in enumerate(self.parameters):
            size = parameter.size
            count = n_levels[j] if n_levels is not None else int(size or 1)
            positions = (np.arange(count) + 0.5) / count
            # Several positions may fall on one likely value, so go by index.
            axes.append(positions if size is None else parameter.level_midpoints((positions * size).astype(np.int64)))
        return np.asarray(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, self.dimension))

    def probabilities(self, points: FloatArray) -> FloatArray:
        """Return the probability of the scenario at each point of a space without continuous parameters.

        It is the product of the parameters' probabilities. Constraints are ignored.

        Parameters
        ----------
        points : ndarray of float64, shape (n, d)
            Points of the unit cube, with one coordinate for each parameter.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        probabilities = np.ones(len(points))
        for j, parameter in enumerate(self.parameters):
            probabilities *= parameter.level_probabilities[parameter.level_indices(points[:, j])]
        return probabilities

    def to_json(self) -> dict[str, Any]:
        """Return JSON values, the inverse of `from_json`.

        Returns
        -------
        dict
        """
        return {
            "parameters": [
                {
                    "name": p.name,
                    "low": p.low,
                    "high": p.high,
                    "step": p.step,
                    "choices": list(p.choices),
                    "unit": p.unit,
                    "distribution": None if p.distribution is None else p.distribution.to_json(),
                    "sets": [dict(members) for members in p.value_sets],
                    # Omitted by default, as in studies of earlier versions.
                    **({"whole": True} if p.is_integer else {}),
                }
                for p in self.parameters
            ],
            "declarations": constraints.declarations_to_json(self.declarations),
        }

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> ParameterSpace:
        """Restore a space from `to_json`.

        Parameters
        ----------
        data : mapping

        Returns
        -------
        ParameterSpace

        Raises
        ------
        InputError
            There are no parameters, or two have the same name.
        """
        parameters = [
            Parameter(
                p["name"],
                p["low"],
                p["high"],
                p["step"],
                tuple(p["choices"]),
                p["unit"],
                None if p["distribution"] is None else distributions.distribution_from_json(p["distribution"]),
                tuple(tuple(members.items()) for members in p["sets"]),
                bool(p.get("whole", False)),
            )
            for p in data["parameters"]
        ]
        return cls(parameters, constraints.declarations_from_json(data["declarations"])).require_parameters()


def _has_discrete_distribution(parameter: Parameter) -> bool:
    """Return whether a parameter has a discrete distribution, so that the parameter cannot become continuous."""
    return parameter.distribution is not None and parameter.distribution.is_discrete
