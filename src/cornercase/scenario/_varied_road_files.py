"""Road files that a varied parameter can select."""

from __future__ import annotations

from itertools import islice, product
from typing import Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase.scenario._batch_split import BatchSplitError
from cornercase.scenario._expressions import parameter_names_in
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._parameter import Parameter, Value
from cornercase.scenario._space import ParameterSpace

# Largest number of combinations that are tried.
_MAX_COMBINATIONS: Final = 1000


def add_varied_roads(scenario: ScenarioFile, space: ParameterSpace) -> ScenarioFile:
    """Return the scenario with the road files that varied parameters can select.

    Return `scenario` itself if no varied parameter determines the road file.
    """
    needed = _road_parameters(scenario)
    chosen = [
        parameter
        for parameter in space.parameters
        if needed & set(parameter.assigned_names) and parameter.size is not None
    ]
    holder = scenario.root.find("RoadNetwork/LogicFile")
    if not chosen or holder is None:
        return scenario
    roads: dict[str, None] = {}
    for combination in islice(product(*map(_assignments_of, chosen)), _MAX_COMBINATIONS):
        values = {name: value for part in combination for name, value in part.items()}
        try:
            scope = scenario.scope([values])
            roads[scope.read_text(holder, "filepath")] = None
        except (InputError, BatchSplitError):
            continue  # reported when the scenario runs
    return scenario.with_varied_roads([road for road in roads if road])


def _road_parameters(scenario: ScenarioFile) -> set[str]:
    """Return the names of the parameters that determine the road file."""
    declared = {
        element.get("name", ""): element.get("value", "")
        for element in scenario.root.iterfind("ParameterDeclarations/ParameterDeclaration")
    }
    names: set[str] = set()
    pending = parameter_names_in(scenario.road_file_as_written())
    while pending:
        name = pending.pop()
        if name not in names:
            names.add(name)
            pending |= parameter_names_in(declared.get(name, ""))
    return names


def _assignments_of(parameter: Parameter) -> list[dict[str, Value]]:
    """Return, for each step or choice of a varied parameter, the values that it sets, by scenario parameter."""
    middles = parameter.level_midpoints(np.arange(min(parameter.size or 0, _MAX_COMBINATIONS)))
    return [parameter.assignment_at(float(u)) for u in middles]
