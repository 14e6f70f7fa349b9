"""One varied parameter: its values, and their positions in the unit interval."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np

from cornercase._common.arguments import number
from cornercase._common.errors import InputError
from cornercase._common.typing import FloatArray, IntArray
from cornercase.scenario.distributions import Distribution

Value = float | str
"""Value of a parameter in a concrete scenario: a number, or one of the choices."""

# Doubles cannot represent all larger integers.
_MOST_STEPS: Final = 2.0**53


@dataclass(frozen=True)
class Parameter:
    """One varied parameter.

    Its values have positions in the unit interval, from 0 to 1. Steps and choices have a part of it each.

    Attributes
    ----------
    name : str
    low, high : float
        Bounds; for choices 0 and their number minus one.
    step : float or None
        Values are low, low + step, … up to `high`; None for a continuous range.
    choices : tuple of str
        Values of a set; empty for a range.
    unit : str
        For tables and axes; empty if unknown.
    distribution : Distribution or None
        Maps the unit interval to values by its inverse distribution function, so that likely values get a large part
        of it; None means uniform.
    sets : tuple of tuple of (str, str)
        For each choice, the scenario's parameters that it sets together, and their values; empty if it sets only the
        parameter of its own name.
    whole : bool
        Whether the scenario declares the values of a range as integers.

    Raises
    ------
    InputError
        A bound or step is not finite, the step is not above 0, the bounds are not in order, or there are too many steps
        to count. Only a range with a step may have a single value.
    """

    name: str
    low: float
    high: float
    step: float | None = None
    choices: tuple[str, ...] = ()
    unit: str = ""
    distribution: Distribution | None = None
    sets: tuple[tuple[tuple[str, str], ...], ...] = ()
    whole: bool = field(default=False, compare=False)

    def __post_init__(self) -> None:
        number("low", self.low)
        number("high", self.high)
        if self.step is not None:
            number("step", self.step, above=0.0)
        single = bool(self.choices) or self.step is not None
        if self.low > self.high or (self.low == self.high and not single):
            raise InputError(
                f"`low` {self.low:g}, `high` {self.high:g}: the lower bound of the parameter {self.name} must be below"
                " the upper."
            )
        if self.step is not None and not (self.high - self.low) / self.step < _MOST_STEPS:
            raise InputError(f"`step` {self.step:g}: the parameter {self.name} has more steps than can be counted.")

    def __repr__(self) -> str:
        law = "" if self.distribution is None else f", {self.distribution.kind}"
        return f"<Parameter {self}{law}>"

    def __str__(self) -> str:
        return f"{self.name} {self.values_text} {self.unit}".rstrip()

    @property
    def values_text(self) -> str:
        """The values in short, as ``"2 to 17 by 0.1"``."""
        if self.choices:
            return ", ".join(self.choices)
        implicit_step = self.step is None or (self.whole and self.step == 1.0)
        return f"{self.low:g} to {self.high:g}" + ("" if implicit_step else f" by {self.step:g}")

    @property
    def size(self) -> int | None:
        """Number of different values; None if infinite."""
        if self.choices:
            return len(self.choices)
        return None if self.step is None else int(np.floor((self.high - self.low) / self.step + 1e-9)) + 1

    @property
    def assigns(self) -> tuple[str, ...]:
        """Names of the scenario's parameters that it sets."""
        return tuple(dict(self.sets[0])) if self.sets else (self.name,)

    def assigned(self, u: float) -> dict[str, Value]:
        """Return the values of the scenario's parameters at a position of the unit interval.

        Parameters
        ----------
        u : float

        Returns
        -------
        dict of str to float or str
        """
        return {name: value for name, (value,) in self.columns(np.array([u])).items()}

    def columns(self, u: FloatArray) -> dict[str, list[Value]]:
        """Return the values of the scenario's parameters at many positions of the unit interval.

        Parameters
        ----------
        u : ndarray of float64, shape (n,)

        Returns
        -------
        dict of str to list of float or str, length n
        """
        if not self.sets:
            return {self.name: self._values(u)}
        members = [dict(assignments) for assignments in self.sets]
        numbers = self.numbers(u).tolist()
        return {name: [members[k][name] for k in numbers] for name in members[0]}

    def read(self, values: Mapping[str, Value]) -> Value:
        """Return the value of this parameter in a concrete scenario.

        Parameters
        ----------
        values : mapping of str to float or str

        Returns
        -------
        float or str
            For values that are set together, the choice that sets them.

        Raises
        ------
        InputError
            No choice sets these values.
        """
        if not self.sets:
            return values[self.name]
        for choice, members in zip(self.choices, self.sets, strict=True):
            if all(str(values.get(name)) == value for name, value in members):
                return choice
        raise InputError(f"No value set of {self.name} has these values.")

    def read_number(self, values: Mapping[str, Value]) -> float:
        """Return the value of this parameter in a concrete scenario, as a number.

        Parameters
        ----------
        values : mapping of str to float or str

        Returns
        -------
        float
            For choices the index, from 0.

        Raises
        ------
        InputError
            No choice sets these values.
        """
        value = self.read(values)
        return float(self.choices.index(str(value)) if self.choices else value)

    def value(self, u: float) -> Value:
        """Return the value at a position of the unit interval.

        Parameters
        ----------
        u : float

        Returns
        -------
        float, int or str
        """
        (value,) = self._values(np.array([u]))
        return value

    def _values(self, u: FloatArray) -> list[Value]:
        """Return the values at positions of the unit interval, shape (n,)."""
        if self.size is None:
            x = self.low + u * (self.high - self.low) if self.distribution is None else self.distribution.quantiles(u)
            return list(x.tolist())
        numbers = self.numbers(u)
        if self.choices:
            return [self.choices[k] for k in numbers.tolist()]
        # Compute each distinct value once.
        met, which = np.unique(numbers, return_inverse=True)
        steps = [_clean(self.low + k * float(self.step or 0.0)) for k in met.tolist()]
        values = [round(value) if self.whole else value for value in steps]
        return [values[k] for k in which.tolist()]

    def unit_place(self, value: Value) -> float:
        """Return the position of a value in the unit interval, the inverse of `value_at`.

        Parameters
        ----------
        value : float or str

        Returns
        -------
        float
            The middle of its step or choice; values out of bounds are clipped.

        Raises
        ------
        InputError
            It is none of the choices.
        """
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
        """Return the index of the step or choice at each position of the unit interval.

        Parameters
        ----------
        u : ndarray of float64, shape (n,)

        Returns
        -------
        ndarray of int64, shape (n,)
        """
        if self._edges is not None:
            return np.asarray(np.searchsorted(self._edges[1:-1], u, side="right"), dtype=np.int64)
        size = self.size or 1
        return np.asarray(np.minimum(np.floor(u * size), size - 1), dtype=np.int64)

    def middles(self, numbers: IntArray) -> FloatArray:
        """Return the middle of the part of the unit interval that each step or choice has.

        Parameters
        ----------
        numbers : ndarray of int64, shape (n,)
            Indices of steps or choices, from 0.

        Returns
        -------
        ndarray of float64, shape (n,)
        """
        if self._edges is not None:
            return np.asarray(0.5 * (self._edges[numbers] + self._edges[numbers + 1]))
        return np.asarray((numbers + 0.5) / (self.size or 1))

    @property
    def shares(self) -> FloatArray:
        """Probability of each step or choice, which is its part of the unit interval, shape (size,)."""
        size = self.size or 1
        return np.full(size, 1.0 / size) if self._edges is None else np.diff(self._edges)

    @cached_property
    def _edges(self) -> FloatArray | None:
        """Bounds of the parts of the unit interval, shape (size + 1,); None if all parts are equal."""
        if self.size is None or self.distribution is None:
            return None
        if self.distribution.discrete:
            return self.distribution.edges()
        # Probability of the interval that is rounded to the value.
        between = self.low + float(self.step or 1.0) * (np.arange(self.size - 1) + 0.5)
        return np.array([0.0, *(self.distribution.place(float(bound)) for bound in between), 1.0])


def _clean(x: float) -> float:
    """Remove rounding errors of added steps, so that 3 × 0.1 is 0.3."""
    return float(f"{x:.12g}")
