"""The road that a scene is drawn on: where it is looked for, and how the page holds it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.errors import InputError
from cornercase._common.texts import quoted_name
from cornercase._common.typing import FloatArray, IntArray
from cornercase.recordings import Recording
from cornercase.roads import Region, RoadNetwork, RoadSketch, lane_borders
from cornercase.scenario import MAPS_VARIABLE, Scenario, Value, find_scenario, way_to_map, with_roads
from cornercase.study import Study, explored_scenario

MARGIN: Final = 40.0
"""How far around the recordings the road is drawn, in m."""


def find_roads(
    study: Study,
    region: Region | None,
    scenario: Path | str | Scenario | None = None,
    values: Mapping[str, Value] | None = None,
) -> tuple[RoadSketch | None, str]:
    """Find the road that was explored, in the scenario file beside the study.

    Parameters
    ----------
    study : Study
        Of which only the name of the scenario file and its fingerprint are taken.
    region : tuple of float, optional
        As of `recorded_region`.
    scenario : path or Scenario, optional
        The scenario file that was explored, where it lies elsewhere.
    values : mapping of str to float or str, optional
        Of a scenario's parameters, one of which may name the road file; by default those that the file declares.

    Returns
    -------
    sketch : RoadSketch or None
        None where there is none.
    missing : str
        Why there is none, as a sentence; it tells no path.

    Raises
    ------
    InputError
        The `scenario` is not the one that was explored.
    """
    if region is None:
        return None, ""
    name = quoted_name(study.meta.file_name)
    try:
        found = explored_scenario(study, scenario)
    except InputError:
        if scenario is not None:
            raise
        return None, _why_not_found(study, name)
    if found is None:
        return None, "The road is not drawn, as no scenario file belongs to recordings that were imported."
    try:
        path = found.road_file(values)
        if path is None:
            return None, f"The road is not drawn, as the scenario file {name} names none."
        # A study may come from anywhere: the value of a parameter leads to no other file.
        if path not in found.road_files():
            return None, f"The road is not drawn, as it is none of those that belong to {name}."
        network = RoadNetwork.of_xml(found.xml(path), path)
    except InputError:
        return None, f"The road is not drawn, as the road file of {name} cannot be read."
    return lane_borders(network, region), ""


def is_of_map(missing: str) -> bool:
    """Tell whether a road is missing, as `find_roads` says it, because its file lies in no folder of maps."""
    return MAPS_VARIABLE in missing


def _why_not_found(study: Study, name: str) -> str:
    meta = study.meta
    plain = f"The road is not drawn, as the scenario file {name} does not lie beside the study as it was."
    try:
        found = find_scenario(meta.file_name, meta.fingerprint, (study.path.parent, Path()), meta.space)
        if found is None:
            return plain
        scenario = with_roads(found if isinstance(found, Scenario) else Scenario.read(found), meta.space)
        reference = scenario.missing_reference()
    except InputError:
        return plain
    if not reference:
        return plain
    road = quoted_name(reference.replace("\\", "/").rpartition("/")[2])
    return f"The road is not drawn, as there is no road file {road} of {name}; {way_to_map(reference)}."


def recorded_region(recordings: Iterable[Recording], margin: float = MARGIN) -> Region | None:
    """Find the region that recordings lie in.

    Parameters
    ----------
    recordings : iterable of Recording
        They are read one after the other.
    margin : float, default 40
        How much is added on each side, in m.

    Returns
    -------
    tuple of float or None
        None where nothing exists in them.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for recording in recordings:
        for k, values in enumerate((recording.x, recording.y)):
            low[k] = min(low[k], np.min(values, initial=np.inf, where=np.isfinite(values)))
            high[k] = max(high[k], np.max(values, initial=-np.inf, where=np.isfinite(values)))
    if not np.isfinite(low).all():
        return None
    return (*(low - margin).tolist(), *(high + margin).tolist())


def pack_roads(sketch: RoadSketch) -> dict[str, Any]:
    """Write what is drawn of roads for the page.

    Parameters
    ----------
    sketch : RoadSketch

    Returns
    -------
    dict of str to object
        ``origin`` in m; ``areas`` and ``lines``, each a list of kinds and numbers: x and y of each point in cm, the
        first from the origin, each other one from the point before.
    """
    every = [*sketch.areas, *sketch.lines]
    origin = np.rint(every[0][1][0]) if every else np.zeros(2)

    def packed(points: FloatArray) -> list[int]:
        whole: IntArray = np.rint((points - origin) * 100.0).astype(np.int64)
        steps = np.diff(whole, axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
        return [int(one) for one in steps[(steps != 0).any(axis=1) | (np.arange(len(steps)) == 0)].ravel()]

    return {
        "origin": origin.tolist(),
        "areas": [[kind, packed(points)] for kind, points in sketch.areas],
        "lines": [[kind, packed(points)] for kind, points in sketch.lines],
    }
