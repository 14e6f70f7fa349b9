"""Critical clusters of an analysis: clusters whose median score is critical."""

from __future__ import annotations

import numpy as np

from cornercase.clustering import Analysis
from cornercase.study import StudyFile


def find_critical_clusters(study: StudyFile, analysis: Analysis) -> list[int]:
    """Return the clusters whose median score of the first metric is critical.

    If all clusters are critical, or the study has no threshold, or a threshold for a weighted sum of metrics, the
    result is only the cluster with the most critical median.
    """
    objective, labels = study.objective, analysis.labels
    metric = objective.metrics[0]
    scores = dict(zip((row.id for row in study.finished_rows()), study.scores(metric.name).tolist(), strict=True))
    oriented = metric.to_minimize(np.array([scores[i] for i in analysis.ids.tolist()]))
    clusters = list(range(analysis.clustering.n_clusters))
    medians = np.array([np.median(oriented[labels == label]) for label in clusters])
    critical = clusters
    if objective.criterion is not None and not objective.weights:
        critical = np.flatnonzero(objective.criterion.is_critical(medians)).tolist()
    return [int(medians.argmin())] if critical == clusters and clusters else critical
