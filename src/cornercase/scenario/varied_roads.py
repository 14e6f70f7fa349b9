"""Road files that are chosen by a varied parameter."""

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

# Largest number of combinations that are tried.
_MOST: Final = 1000


def with_roads(scenario: Scenario, space: ParameterSpace) -> Scenario:
    """Return the scenario with the road files that the space can choose; the same object if there are none."""
    needed = _needed(scenario)
    chosen = [
        parameter for parameter in space.parameters if needed & set(parameter.assigns) and parameter.size is not None
    ]
    holder = scenario.root.find("RoadNetwork/LogicFile")
    if not chosen or holder is None:
        return scenario
    roads: dict[str, None] = {}
    for combination in islice(product(*map(_choices, chosen)), _MOST):
        values = {name: value for part in combination for name, value in part.items()}
        try:
            scope = Scope.of_file(str(scenario.path), scenario.root, [values], scenario.catalog_entry)
            roads[scope.text(holder, "filepath")] = None
        except (InputError, VariesError):
            continue  # reported when the scenario runs
    return scenario.naming([road for road in roads if road])


def _needed(scenario: Scenario) -> set[str]:
    """Parameters that the road file depends on."""
    declared = {
        element.get("name", ""): element.get("value", "")
        for element in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
    }
    names: set[str] = set()
    pending = names_in(scenario.logic_file())
    while pending:
        name = pending.pop()
        if name not in names:
            names.add(name)
            pending |= names_in(declared.get(name, ""))
    return names


def _choices(parameter: Parameter) -> list[dict[str, Value]]:
    """What each value of a parameter sets."""
    middles = parameter.middles(np.arange(min(parameter.size or 0, _MOST)))
    return [parameter.assigned(float(u)) for u in middles]
