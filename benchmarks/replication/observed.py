"""What happened in the runs of a study, as the statements need it."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt
from benchmarks.replication.causes import find_causes
from benchmarks.replication.family import PAPER_GAMMA, Reading
from scipy.spatial import cKDTree

from cornercase.clustering import ASPECTS, Clustering, cluster
from cornercase.clustering._series import read_series
from cornercase.dtw import distance_matrix
from cornercase.evidence._sensitivity import estimate_sensitivity
from cornercase.metrics._ending import describe_outcome
from cornercase.recordings import Collision, Recording
from cornercase.study import StudyFile
from cornercase.study._objective import Objective

Floats = npt.NDArray[np.float64]
Bools = npt.NDArray[np.bool_]
Labels = npt.NDArray[np.int64]

ASPECTS_OF: Final = {
    "x-intersection": ("ego-trajectory", "ego-motion", "trajectory-distance", "wttc"),
    "t-intersection": ("ego-trajectory", "distance", "traffic-quality"),
}
"""Aspects that the statements need, by scenario."""

# Instants of long recordings are thinned to about as many.
MOST_INSTANTS = 300


@dataclass(eq=False)
class Observed:
    """All runs of a study: n points in the unit cube, and what happened there."""

    names: tuple[str, ...]
    points: Floats
    values: Mapping[str, Floats]
    scores: Mapping[str, Floats]
    total: Mapping[str, float]
    ends: npt.NDArray[np.str_]
    crash: Bools
    recordings: Sequence[Recording]
    collisions: Sequence[Collision | None]
    ego: str
    road_file: Path
    series: Mapping[str, list[Floats]]
    stride: Mapping[str, int]
    causes: dict[str, npt.NDArray[np.str_]] = field(default_factory=dict)
    matrices: dict[str, Floats] = field(default_factory=dict)
    clusterings: dict[tuple[str, bool], Clustering] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path, seed: int, aspects: tuple[str, ...], road_file: Path) -> Observed:
        """Read what happened from a study; accidents are judged by the road file."""
        with StudyFile.open(path) as study:
            rows, meta = study.finished_rows(), study.meta
            points = np.array([row.point for row in rows])
            scores = {name: study.scores(name) for name in meta.metrics}
            searched = Objective.from_study_meta(meta).compute_scores_to_minimize(
                np.stack(list(scores.values()), axis=1)
            )
            influence = estimate_sensitivity(study.space, points, searched, seed)
            recordings = [study.recording(row.id) for row in rows]
            series, strides = {}, {}
            for name in aspects:
                if name in meta.metrics:
                    long = list(read_series(study, name))
                else:
                    aspect = ASPECTS.create(name)
                    long = [aspect.series(one, meta.ego, meta.others[0]) for one in recordings]
                strides[name] = max(1, round(float(np.median([len(one) for one in long])) / MOST_INSTANTS))
                series[name] = [one[:: strides[name]] for one in long]
            return cls(
                names=study.space.names,
                points=points,
                values={n: np.array([float(row.values[n]) for row in rows]) for n in study.space.names},
                scores=scores,
                total=dict(zip(influence.names, map(float, influence.total), strict=True)),
                ends=np.array([describe_outcome(one, meta.ego, meta.others[0]) for one in recordings]),
                crash=np.array([any(meta.ego in hit.entities for hit in one.collisions) for one in recordings]),
                recordings=recordings,
                collisions=[
                    next((hit for hit in one.collisions if meta.ego in hit.entities), None) for one in recordings
                ],
                ego=meta.ego,
                road_file=road_file,
                series=series,
                stride=strides,
            )

    def distances(self, aspect: str) -> Floats:
        """Distances of all scenarios by an aspect."""
        if aspect not in self.matrices:
            self.matrices[aspect] = distance_matrix(self.series[aspect])
        return self.matrices[aspect]

    def clustering(self, aspect: str, reading: Reading) -> Clustering:
        """Clusters by an aspect with the settings of a reading."""
        key = (aspect, reading.settings is None)
        if key not in self.clusterings:
            distances = self.distances(aspect)
            if reading.settings is None:
                self.clusterings[key] = cluster(distances)
            else:
                # `cluster` divides by the median, the paper's gamma is taken for distances divided by the largest one.
                share = float(np.median(distances[distances > 0.0]) / distances.max())
                eps, neighbours = reading.settings[aspect]
                self.clusterings[key] = cluster(
                    distances, gamma=PAPER_GAMMA * share**2, eps=eps, min_samples=neighbours, n_components=3
                )
        return self.clusterings[key]

    def caused(self, rule: str, road_file: Path | None = None) -> npt.NDArray[np.str_]:
        """Who causes each accident by a rule, by default with the scenario's road file."""
        key = f"{rule} {road_file or ''}"
        if key not in self.causes:
            found = find_causes(self.recordings, self.collisions, self.ego, rule, road_file or self.road_file)
            self.causes[key] = np.array(found)
        return self.causes[key]

    def ended(self, text: str) -> Bools:
        """Scenarios that ended so."""
        return np.asarray(self.ends == text)

    def nearest_run(self, places: Floats, names: tuple[str, ...]) -> Labels:
        """Run nearest to each place of the unit cube, in some of the parameters."""
        columns = [self.names.index(name) for name in names]
        return np.asarray(cKDTree(self.points[:, columns]).query(places)[1], dtype=np.int64)

    def seconds_compiled(self, aspect: str, count: int) -> float:
        """CPU seconds for the distances of the first scenarios."""
        start = time.process_time()
        distance_matrix(self.series[aspect][:count], n_jobs=1)
        return time.process_time() - start
