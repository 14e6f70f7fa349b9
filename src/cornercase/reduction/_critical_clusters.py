"""Critical clusters of an analysis."""

from __future__ import annotations

import numpy as np

from cornercase.clustering import Analysis
from cornercase.exploration._objective import Objective
from cornercase.study import StudyFile


def find_critical_clusters(study: StudyFile, analysis: Analysis) -> list[int]:
    """Return the clusters whose median score of the first metric is critical.

    If that holds for all clusters, or there is no threshold, the one cluster with the most critical median.
    """
    meta = study.meta
    objective, labels = Objective.from_study_meta(meta), analysis.labels
    metric = objective.metrics[0]
    scores = dict(zip((row.id for row in study.finished_rows()), study.scores(metric.name).tolist(), strict=True))
    oriented = metric.to_minimize(np.array([scores[i] for i in analysis.ids.tolist()]))
    clusters = list(range(analysis.clustering.n_clusters))
    medians = {label: float(np.median(oriented[labels == label])) for label in clusters}
    critical = clusters
    if study.critical is not None and not objective.weights and not objective.pareto:
        critical = [label for label in clusters if medians[label] <= objective.convert_orientation(study.critical)]
    return [min(clusters, key=medians.__getitem__)] if critical == clusters and clusters else critical
