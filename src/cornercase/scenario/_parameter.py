"""Varied parameters: each value has a position in the unit interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase._common.validation import check_float
from cornercase.scenario._distributions import Distribution

Value = float | str
"""Value of a parameter in a concrete scenario: a number, or one of the choices."""

# Doubles cannot represent all larger integers.
_MAX_STEPS: Final = 2.0**53
# Largest rounding of a value in steps, as a part of the step.
_MAX_ROUNDING: Final = 1e-3


@dataclass(frozen=True)
class Parameter:
    """A varied parameter.

    Each value has a position in the unit interval, from 0 to 1. In a range with steps, and for choices, each value
    covers a part of the interval.

    Attributes
    ----------
    name : str
    low, high : float
        Bounds of the range. For choices: 0, and the number of choices minus 1.
    step : float or None
        The values are low, low + step, … up to `high`. None for a continuous range.
    choices : tuple of str
        The possible values if they are a set of texts; empty for a range.
    unit : str
        Unit for tables and axes; empty if unknown.
    distribution : Distribution or None
        Probability distribution of the values; None means uniform. A position in the unit interval is a cumulative
        probability, so likely values cover a larger part of the interval.
    value_sets : tuple of tuple of (str, str)
        For each choice, the names and values of all scenario parameters that the choice sets. Empty if a choice sets
        only one scenario parameter, which is called `name`.
    is_integer : bool
        Whether the scenario declares the values of a range as integers.

    Raises
    ------
    InputError
        A bound or step is not finite, the step is not above 0, the bounds are not in order, or there are too many steps
        to count. The bounds may be equal only if there is a step, or if there are choices.

    Examples
    --------
    >>> import cornercase as cc
    >>> speed = cc.Parameter("speed", 5.0, 15.0, 0.5, unit="m/s")
    >>> speed, speed.size
    (<Parameter speed 5 to 15 by 0.5 m/s>, 21)
    """

    name: str
    low: float
    high: float
    step: float | None = None
    choices: tuple[str, ...] = ()
    unit: str = ""
    distribution: Distribution | None = None
    value_sets: tuple[tuple[tuple[str, str], ...], ...] = ()
    is_integer: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        check_float("low", self.low)
        check_float("high", self.high)
        if self.step is not None:
            check_float("step", self.step, above=0.0)
        single = bool(self.choices) or self.step is not None
        if self.low > self.high or (self.low == self.high and not single):
            raise InputError(
                f"`low` {self.low:g}, `high` {self.high:g}: the lower bound of the parameter {self.name} must be below"
                " the upper."
            )
        if self.step is not None and not (self.high - self.low) / self.step < _MAX_STEPS:
            raise InputError(f"`step` {self.step:g}: the parameter {self.name} has more steps than can be counted.")

    def __repr__(self) -> str:
        law = "" if self.distribution is None else f", {self.distribution.kind}"
        return f"<Parameter {self}{law}>"

    def __str__(self) -> str:
        return f"{self.name} {self.values_text} {self.unit}".rstrip()

    @property
    def values_text(self) -> str:
        """Short description of the values, such as ``"2 to 17 by 0.1"``."""
        if self.choices:
            return ", ".join(self.choices)
        if self.low == self.high:
            return f"{self.low:g}"
        implicit_step = self.step is None or (self.is_integer and self.step == 1.0)
        return f"{self.low:g} to {self.high:g}" + ("" if implicit_step else f" by {self.step:g}")

    @property
    def size(self) -> int | None:
        """Number of different values; None if infinite."""
        if self.choices:
            return len(self.choices)
        return None if self.step is None else int(np.floor((self.high - self.low) / self.step + 1e-9)) + 1

    @property
    def assigned_names(self) -> tuple[str, ...]:
        """Names of the scenario parameters that this parameter sets."""
        return tuple(dict(self.value_sets[0])) if self.value_sets else (self.name,)

    def assignment_at(self, unit_position: float) -> dict[str, Value]:
        """Return the scenario parameters that this parameter sets at a position of the unit interval, and their values.

        Parameters
        ----------
        unit_position : float

        Returns
        -------
        dict of str to float or str
        """
        return {name: value for name, (value,) in self.assignments_at(np.array([unit_position])).items()}

    def assignments_at(self, unit_positions: FloatArray) -> dict[str, list[Value]]:
        """Return the scenario parameters that this parameter sets at positions of the unit interval, and their values.

        Parameters
        ----------
        unit_positions : ndarray of float64, shape (n,)

        Returns
        -------
        dict of str to list of float or str, length n
        """
        if not self.value_sets:
            return {self.name: self._values_at(unit_positions)}
        members = [dict(assignments) for assignments in self.value_sets]
        numbers = self.level_indices(unit_positions).tolist()
        return {name: [members[k][name] for k in numbers] for name in members[0]}

    def extract_value(self, values: Mapping[str, Value]) -> Value:
        """Return the value of this parameter in a concrete scenario.

        Parameters
        ----------
        values : mapping of str to float or str

        Returns
        -------
        float or str
            If the choices set several scenario parameters together: the choice that sets the given values.

        Raises
        ------
        InputError
            No choice sets these values.
        """
        if not self.value_sets:
            return values[self.name]
        for choice, members in zip(self.choices, self.value_sets, strict=True):
            if all(str(values.get(name)) == value for name, value in members):
                return choice
        raise InputError(f"The varied parameters {self.name} have no set of values that are those of the scenario.")

    def extract_number(self, values: Mapping[str, Value]) -> float:
        """Return the value of this parameter in a concrete scenario, as a number.

        Parameters
        ----------
        values : mapping of str to float or str

        Returns
        -------
        float
            For choices: the index of the choice, from 0.

        Raises
        ------
        InputError
            No choice sets these values.
        """
        value = self.extract_value(values)
        return float(self._choice_index(value) if self.choices else value)

    def _choice_index(self, value: Value) -> int:
        if str(value) not in self.choices:
            raise InputError(f"The parameter {self.name} has no value '{value}'.")
        return self.choices.index(str(value))

    def value_at(self, unit_position: float) -> Value:
        """Return the value at a position of the unit interval.

        Parameters
        ----------
        unit_position : float

        Returns
        -------
        float, int or str
        """
        (value,) = self._values_at(np.array([unit_position]))
        return value

    def _values_at(self, unit_positions: FloatArray) -> list[Value]:
        """Return the values at positions of the unit interval, shape (n,)."""
        if self.size is None:
            x = (
                self.low + unit_positions * (self.high - self.low)
                if self.distribution is None
                else self.distribution.quantiles(unit_positions)
            )
            return list(x.tolist())
        numbers = self.level_indices(unit_positions)
        if self.choices:
            return [self.choices[k] for k in numbers.tolist()]
        # Compute each distinct value once.
        met, which = np.unique(numbers, return_inverse=True)
        values = [self._step_value(k, float(self.step or 0.0)) for k in met.tolist()]
        return [values[k] for k in which.tolist()]

    def _step_value(self, index: int, step: float) -> float:
        value = self.low + index * step
        if self.is_integer:
            return round(value)
        # Without the rounding error of the sum, 3 × 0.1 gives 0.3; but steps of large values have more digits.
        rounded = float(f"{value:.12g}")
        return max(rounded if abs(rounded - value) < _MAX_ROUNDING * step else value, self.low)

    def unit_position(self, value: Value) -> float:
        """Return the position of a value in the unit interval, the inverse of `value_at`.

        Parameters
        ----------
        value : float or str

        Returns
        -------
        float
            For a value in steps, or a choice, the middle of the part of the interval that it covers. Values outside
            the range are clipped.

        Raises
        ------
        InputError
            The value is none of the choices.
        """
        size = self.size
        if self.choices:
            return float(self.level_midpoints(np.array([self._choice_index(value)]))[0])
        x = float(value)
        if size is not None:
            k = round((x - self.low) / float(self.step or 1.0))
            return float(self.level_midpoints(np.array([min(max(k, 0), size - 1)]))[0])
        if self.distribution is not None:
            return self.distribution.cdf(x)
        return float(np.clip((x - self.low) / (self.high - self.low), 0.0, 1.0))

    def level_indices(self, unit_positions: FloatArray) -> IntArray:
        """Return the index of the step or choice that covers each position of the unit interval.

        Parameters
        ----------
        unit_positions : ndarray of float64, shape (n,)

        Returns
        -------
        ndarray of int64, shape (n,)
        """
        if self._level_edges is not None:
            return np.asarray(np.searchsorted(self._level_edges[1:-1], unit_positions, side="right"), dtype=np.int64)
        size = self.size or 1
        return np.asarray(np.minimum(np.floor(unit_positions * size), size - 1), dtype=np.int64)

    def level_midpoints(self, indices: IntArray) -> FloatArray:
        """Return the middle of the part of the unit interval that each step or choice covers.

        Parameters
        ----------
        indices : ndarray of int64, shape (n,)
            Indices of steps or choices, from 0.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        if self._level_edges is not None:
            return np.asarray(0.5 * (self._level_edges[indices] + self._level_edges[indices + 1]))
        return np.asarray((indices + 0.5) / (self.size or 1))

    @property
    def level_probabilities(self) -> FloatArray:
        """Probability of each step or choice, shape (size,): the length of its part of the unit interval."""
        size = self.size or 1
        return np.full(size, 1.0 / size) if self._level_edges is None else np.diff(self._level_edges)

    @cached_property
    def _level_edges(self) -> FloatArray | None:
        """Edges of the parts of the unit interval that the steps or choices cover, shape (size + 1,).

        None for a continuous range, or if all parts have the same length.
        """
        if self.size is None or self.distribution is None:
            return None
        if self.distribution.is_discrete:
            return self.distribution.cumulative_probabilities()
        # Probability of the interval that is rounded to the value.
        between = self.low + float(self.step or 1.0) * (np.arange(self.size - 1) + 0.5)
        return np.array([0.0, *(self.distribution.cdf(float(bound)) for bound in between), 1.0])
