"""Road and re-run information of the live page."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from cornercase._common.ledger import warn
from cornercase.report.data import ReportData
from cornercase.report.rerun import tell_rerun
from cornercase.report.roads import find_roads, is_of_map, pack_roads
from cornercase.roads import Region
from cornercase.study import Study

# Additional margin in m, so that the road is not redrawn for each scenario.
_MORE: Final = 60.0


class Surroundings:
    """Caches the road drawing and redraws it only if scenarios leave the drawn region."""

    def __init__(self, scenario: Path | None) -> None:
        self._scenario = scenario
        self._fingerprint = ""
        self._region: Region | None = None
        self._roads: dict[str, Any] = {}
        self._said: set[str] = set()

    def of(self, study: Study, data: ReportData) -> dict[str, Any]:
        """Return ``roads``, ``roads_missing`` and ``rerun`` of the page's contents."""
        new, old = data.region, self._region
        is_known = study.meta.fingerprint == self._fingerprint and bool(self._roads.get("roads"))
        if not is_known or not _holds(old, new):
            region = None if new is None else (new[0] - _MORE, new[1] - _MORE, new[2] + _MORE, new[3] + _MORE)
            sketch, missing = find_roads(study, region, self._scenario, data.rows[0].values)
            self._roads = {"roads": None if sketch is None else pack_roads(sketch), "roads_missing": missing}
            if is_of_map(missing) and missing not in self._said:
                self._said.add(missing)
                warn(missing.removesuffix("."))
            self._fingerprint, self._region = study.meta.fingerprint, region
        return self._roads | {"rerun": tell_rerun(study, self._scenario, whole=False)}


def _holds(old: Region | None, new: Region | None) -> bool:
    if old is None or new is None:
        return new is None
    return old[0] <= new[0] and old[1] <= new[1] and old[2] >= new[2] and old[3] >= new[3]
