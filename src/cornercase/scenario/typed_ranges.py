"""Ranges of parameters that are no floating-point numbers."""

from __future__ import annotations

from dataclasses import replace
from math import ceil, floor

from cornercase._common.errors import InputError
from cornercase.scenario.declared_types import INTEGERS, typed_value, value_text
from cornercase.scenario.parameter import Parameter

# So many values of a range become the choices of a parameter that is no number, and get a probability each.
_MOST_CHOICES = 1000
_MOST_LIKELY = 100_000


def typed_parameter(parameter: Parameter, kind: str, source: str) -> Parameter:
    """Give a varied parameter the type that the scenario declares.

    Parameters
    ----------
    parameter : Parameter
    kind : str
        ``"double"``, ``"integer"``, ``"boolean"``, ``"string"`` or another one of OpenSCENARIO.
    source : str
        Name of the scenario file, for messages.

    Returns
    -------
    Parameter

    Raises
    ------
    InputError
        Its range holds what is no value of that type.
    """
    if parameter.choices or kind == "double":
        return parameter
    where = f"{source}: the parameter {parameter.name} is declared as {kind}"
    if kind in INTEGERS:
        return _whole(parameter, kind, where)
    if kind == "boolean":
        if (parameter.low, parameter.high) != (0.0, 1.0) or parameter.step not in (None, 1.0):
            raise InputError(f"{where}, and its range is {parameter.values_text}; vary it as {parameter.name}=0:1.")
        return _chosen(parameter, ("false", "true"))
    if parameter.size is None:
        raise InputError(
            f"{where}, and its range is {parameter.values_text}; give a step, as {parameter.name}=LOW:HIGH:STEP, or a"
            " `space` file with a <DistributionSet>."
        )
    if parameter.size > _MOST_CHOICES:
        raise InputError(f"{where}, and its range has {parameter.size} values; it may have {_MOST_CHOICES}.")
    values = [parameter.low + k * float(parameter.step or 1.0) for k in range(parameter.size)]
    return _chosen(parameter, tuple(value_text(float(f"{value:.12g}")) for value in values))


def _whole(parameter: Parameter, kind: str, where: str) -> Parameter:
    step = 1.0 if parameter.step is None else parameter.step
    low, high = float(ceil(parameter.low - 1e-9)), float(floor(parameter.high + 1e-9))
    if step != round(step) or (parameter.step is not None and low != parameter.low) or low > high:
        raise InputError(
            f"{where}, and its range is {parameter.values_text}; give whole numbers as bounds, and as step."
        )
    for bound in (low, high):
        try:
            typed_value(bound, kind)
        except ValueError as why:
            raise InputError(f"{where}, and its range ends at {bound:g}, {why}.") from None
    typed = replace(parameter, low=low, high=high, step=step, whole=True)
    if typed.distribution is not None and (typed.size or 0) > _MOST_LIKELY:
        raise InputError(f"{where}, and its distribution has {typed.size} values; it may have {_MOST_LIKELY}.")
    return typed


def _chosen(parameter: Parameter, choices: tuple[str, ...]) -> Parameter:
    if parameter.distribution is not None:
        raise InputError(f"The parameter {parameter.name} is not a number, and cannot have a distribution of numbers.")
    return Parameter(parameter.name, 0.0, len(choices) - 1.0, None, choices, unit=parameter.unit)
