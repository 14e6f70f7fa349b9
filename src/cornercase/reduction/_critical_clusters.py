"""Critical clusters of an analysis."""

from __future__ import annotations

import numpy as np

from cornercase.clustering import Analysis
from cornercase.study import StudyFile


def find_critical_clusters(study: StudyFile, analysis: Analysis) -> list[int]:
    """Return the clusters whose median score of the first metric is critical.

    If that holds for all clusters, or there is no threshold, the result is the cluster with the most critical median.
    """
    criterion, labels = study.criterion, analysis.labels
    metric = criterion.objective.metrics[0]
    scores = dict(zip((row.id for row in study.finished_rows()), study.scores(metric.name).tolist(), strict=True))
    oriented = metric.to_minimize(np.array([scores[i] for i in analysis.ids.tolist()]))
    clusters = list(range(analysis.clustering.n_clusters))
    medians = {label: float(np.median(oriented[labels == label])) for label in clusters}
    critical = clusters
    if criterion.oriented is not None and not criterion.objective.weights:
        critical = [label for label in clusters if medians[label] <= criterion.oriented]
    return [min(clusters, key=medians.__getitem__)] if critical == clusters and clusters else critical
