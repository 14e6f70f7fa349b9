"""Outline of the road of a scenario, encoded as a drawing for the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.text.sanitize import quote_name
from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings import Recording
from cornercase.roads._network import RoadNetwork
from cornercase.roads._outline import Region, RoadOutline, outline_roads
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._maps import MAPS_VARIABLE, describe_how_to_get_map
from cornercase.scenario._scenario_search import find_scenario_file
from cornercase.scenario._varied_road_files import add_varied_roads
from cornercase.study import StudyFile
from cornercase.study._scenario_digest import find_bounds
from cornercase.study._scenario_file import find_explored_scenario

ROAD_MARGIN: Final = 40.0
"""Distance around the recordings up to which the road is drawn, in m."""


def find_road_outline(
    study: StudyFile,
    region: Region | None,
    scenario: Path | str | ScenarioFile | None = None,
    values: Mapping[str, Value] | None = None,
) -> tuple[RoadOutline | None, str]:
    """Return the outline of the road in `region`, or None and a sentence that explains why there is none.

    The road is the road that the scenario file names: the file `scenario`, by default the file that
    `find_explored_scenario` finds. `values` are the parameter values of a scenario, since a parameter may choose the
    road file. The sentence contains no folders of this machine. InputError if `scenario` is not the file that was
    explored.
    """
    if region is None:
        return None, ""
    name = quote_name(study.meta.file_name)
    try:
        explored = find_explored_scenario(study, scenario)
    except InputError:
        if scenario is not None:
            raise
        return None, _describe_missing_scenario(study, name)
    if explored is None:
        return None, "The road is not drawn, as no scenario file belongs to recordings that were imported."
    try:
        path = explored.road_path_for(values)
        if path is None:
            return None, f"The road is not drawn, as the scenario file {name} names none."
        # Studies may be untrusted: a parameter value must not lead to any other file.
        if path not in explored.road_paths():
            return None, f"The road is not drawn, as it is none of those that belong to {name}."
        network = RoadNetwork.from_xml(explored.get_root(path), path)
    except InputError:
        return None, f"The road is not drawn, as the road file of {name} cannot be read."
    return outline_roads(network, region), ""


def is_missing_map(reason: str) -> bool:
    """Return whether `reason`, a sentence from `find_road_outline`, says that a map is missing in the map folders."""
    return MAPS_VARIABLE in reason


def _describe_missing_scenario(study: StudyFile, name: str) -> str:
    meta = study.meta
    default = f"The road is not drawn, as the scenario file {name} does not lie beside the study as it was."
    try:
        folders = study.path.parent, Path()
        scenario, changed = find_scenario_file(meta.file_name, meta.fingerprint, folders, meta.space)
        if scenario is None:
            if not changed:
                return default
            scenario = add_varied_roads(ScenarioFile.read(changed[0]), meta.space)
        reference = scenario.first_missing_road_file()
    except InputError:
        return default
    if not reference:
        return default
    road = quote_name(reference.replace("\\", "/").rpartition("/")[2])
    return f"The road is not drawn, as there is no road file {road} of {name}; {describe_how_to_get_map(reference)}."


def recorded_bounds(recordings: Iterable[Recording]) -> Region | None:
    """Return the bounding box of all positions in m, enlarged by 40 m on each side; None if there are no positions."""
    boxes = [box for recording in recordings if (box := find_bounds(recording)) is not None]
    if not boxes:
        return None
    x_min, y_min, x_max, y_max = zip(*boxes, strict=True)
    return add_road_margin((min(x_min), min(y_min), max(x_max), max(y_max)))


def add_road_margin(bounds: Region | None) -> Region | None:
    """Enlarge a bounding box by 40 m on each side, so that the road is drawn up to this distance; None stays None."""
    if bounds is None:
        return None
    x_min, y_min, x_max, y_max = bounds
    return x_min - ROAD_MARGIN, y_min - ROAD_MARGIN, x_max + ROAD_MARGIN, y_max + ROAD_MARGIN


def encode_road_outline(sketch: RoadOutline) -> dict[str, Any]:
    """Encode the outline of a road as JSON values for the page.

    ``areas`` and ``lines`` hold, for each shape, its kind and a flat list of x and y in cm: the first point relative to
    ``origin``, then each point relative to the previous one. ``origin`` is in m.
    """
    shapes = [*sketch.areas, *sketch.lines]
    origin = np.rint(shapes[0][1][0]) if shapes else np.zeros(2)

    def encode_points(points: FloatArray) -> list[int]:
        whole: IntArray = np.rint((points - origin) * 100.0).astype(np.int64)
        steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
        return [int(number) for number in steps[(steps != 0).any(axis=1) | (np.arange(len(steps)) == 0)].ravel()]

    return {
        "origin": origin.tolist(),
        "areas": [[kind, encode_points(points)] for kind, points in sketch.areas],
        "lines": [[kind, encode_points(points)] for kind, points in sketch.lines],
    }
