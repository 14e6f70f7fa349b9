"""Road files that a varied parameter names."""

from __future__ import annotations

from itertools import islice, product
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase.scenario.expressions import names_in
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.parameter import Parameter, Value
from cornercase.scenario.scope import Scope
from cornercase.scenario.space import ParameterSpace
from cornercase.scenario.varies import VariesError

# So many combinations of values are looked at; nobody has more roads.
_MOST: Final = 1000


def with_roads(scenario: Scenario, space: ParameterSpace) -> Scenario:
    """Count the road files that a space names among the files of a scenario.

    Parameters
    ----------
    scenario : Scenario
    space : ParameterSpace

    Returns
    -------
    Scenario
        The `scenario` itself, where no varied parameter names its road file.
    """
    needed = _needed(scenario)
    chosen = [one for one in space.parameters if needed & set(one.assigns) and one.size is not None]
    holder = scenario.root.find("RoadNetwork/LogicFile")
    if not chosen or holder is None:
        return scenario
    roads: dict[str, None] = {}
    for parts in islice(product(*map(_choices, chosen)), _MOST):
        values = {name: value for part in parts for name, value in part.items()}
        try:
            scope = Scope.of_file(str(scenario.path), scenario.root, [values], scenario.catalog_entry)
            roads[scope.text(holder, "filepath")] = None
        except (InputError, VariesError):
            continue  # said where the scenario is run
    return scenario.naming([road for road in roads if road])


def _needed(scenario: Scenario) -> set[str]:
    """Parameters that the road file depends on."""
    declared = {
        element.get("name", ""): element.get("value", "")
        for element in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
    }
    found: set[str] = set()
    waiting = names_in(scenario.logic_file())
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting |= names_in(declared.get(name, ""))
    return found


def _choices(parameter: Parameter) -> list[dict[str, Value]]:
    """What each value of a parameter assigns."""
    middles = parameter.middles(np.arange(min(parameter.size or 0, _MOST)))
    return [parameter.assigned(float(u)) for u in middles]
