"""Which concrete scenarios fulfil the constraints of their parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cornercase._common.typing import BoolArray
from cornercase.scenario.constraints import Declaration
from cornercase.scenario.parameter import Value
from cornercase.scenario.scope import Scope
from cornercase.scenario.varies import VariesError


def admitted(
    declarations: Sequence[Declaration], values: Sequence[Mapping[str, Value]], source: str = "the scenario"
) -> BoolArray:
    """Which concrete scenarios fulfil the constraints of their parameters' declarations.

    Parameters
    ----------
    declarations : sequence of Declaration
        All parameters that the scenario declares.
    values : sequence of mapping, length n
        Values of those that are varied.
    source : str
        Name of the file, for messages.

    Returns
    -------
    ndarray of bool, shape (n,)

    Raises
    ------
    InputError
        An expression cannot be evaluated.
    """
    result = np.ones(len(values), dtype=np.bool_)
    try:
        scope = Scope.of_declarations(source, declarations, values)
    except VariesError as varies:
        # Texts have one value for all; so each combination of them is looked at by itself.
        names = sorted(varies.names)
        keys = [tuple(str(one.get(name)) for name in names) for one in values]
        alike: dict[tuple[str, ...], list[int]] = {}
        for i, key in enumerate(keys):
            alike.setdefault(key, []).append(i)
        for rows in alike.values():
            result[rows] = admitted(declarations, [values[i] for i in rows], source)
        return result
    for broken in scope.broken(declarations).values():
        result &= ~broken
    return result
