"""Map of clustering settings: the clusters for a grid of gamma, eps and min_samples, and how good they are."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np

from cornercase._common.numba.blas import single_threaded_blas
from cornercase._common.typing import FloatArray, IntArray
from cornercase.clustering._auto_settings import canonical_order
from cornercase.clustering._clustering import NOISE_LABEL, Candidate
from cornercase.clustering._density import cluster_by_density
from cornercase.clustering._kernel_pca import KernelPca
from cornercase.clustering._stability import StabilityScorer
from cornercase.clustering._stored_analysis import Analysis, read_distances, read_landmark_distances
from cornercase.evidence._criticality_bands import explained_variance
from cornercase.study import StudyFile

GAMMAS: Final = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
EPS: Final = (0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.7, 1.0)
"""Grid of gamma (kernel width) and eps (neighbourhood radius): round values, which are easy to type.

The gamma of the paper, 100, is among them.
"""
N_COMPONENTS: Final = 3
"""Number of dimensions of the kernel space, as in the paper, and as in `analyze` if gamma and eps are given."""
MAX_MAPPED: Final = 500
"""Largest number of scenarios for which the map is computed; if there are more, it uses a random sample."""
_STABILITY, _AGREEMENT, _EXPLAINED = "stability", "agreement", "explained "


@dataclass(frozen=True, eq=False)
class SettingsMap:
    """Clusters of n scenarios by one aspect (what scenarios are compared by) for each setting of a grid.

    The grid has g values of `gammas` (kernel width), e values of `eps` (neighbourhood radius) and m values of
    `min_samples` (scenarios in a dense neighbourhood).

    `rows`, shape (n,), are the rows of the scenarios in the analysis: all rows, a random sample, or the landmarks
    (scenarios that were all compared with each other).
    `labels` has shape (m, g, e, n), `embeddings` has shape (g, n, 3).

    All other arrays have shape (m, g, e). `noise` is the share of scenarios in no cluster. `stability` is the agreement
    with clusters of random parts of the scenarios, NaN if all scenarios are in one cluster or all are noise.
    `agreement` is the adjusted mutual information of clusters and outcomes, NaN if all scenarios end in the same way.
    `explained` maps each metric to the share of the variance of its scores that the clusters explain, NaN if the scores
    do not vary.
    """

    rows: IntArray
    gammas: tuple[float, ...]
    eps: tuple[float, ...]
    min_samples: tuple[int, ...]
    labels: IntArray
    embeddings: FloatArray
    n_clusters: IntArray
    noise: FloatArray
    stability: FloatArray
    agreement: FloatArray
    explained: Mapping[str, FloatArray]


@dataclass(frozen=True, eq=False)
class OutcomesAndScores:
    """Outcomes and scores of n scenarios.

    All arrays have shape (n,). `outcome` has indices into `outcome_names`. `scores` maps each metric to its scores.
    """

    ids: IntArray
    outcome: IntArray
    outcome_names: tuple[str, ...]
    scores: Mapping[str, FloatArray]

    @classmethod
    def from_study(cls, study: StudyFile) -> OutcomesAndScores:
        """Read the outcomes and scores of all finished scenarios of a study."""
        other = study.meta.others.index(study.primary_other())
        texts = {scenario: digest.outcomes[other].text for scenario, digest in study.iter_digests(())}
        names = sorted(set(texts.values()))
        outcome = np.array([names.index(text) for text in texts.values()], dtype=np.int64)
        scores = {name: study.scores(name) for name in study.meta.metrics}
        return cls(np.array(list(texts), dtype=np.int64), outcome, tuple(names), scores)

    def select(self, ids: IntArray) -> OutcomesAndScores:
        """Return the outcomes and scores of the scenarios `ids`, in this order."""
        row_of = {scenario: row for row, scenario in enumerate(self.ids.tolist())}
        rows = np.array([row_of[scenario] for scenario in ids.tolist()], dtype=np.int64)
        scores = {name: values[rows] for name, values in self.scores.items()}
        return OutcomesAndScores(ids, self.outcome[rows], self.outcome_names, scores)


def choose_min_samples_values(n_scenarios: int) -> tuple[int, ...]:
    """Return the values of min_samples for a settings map, rising.

    These are 3, the automatic value (``ln(n)``, rounded up and at least 3), and twice the automatic value.
    """
    usual = max(3, math.ceil(math.log(max(n_scenarios, 2))))
    return tuple(sorted({3, usual, 2 * usual}))


def compute_settings_map(
    study: StudyFile,
    analysis: Analysis,
    observed: OutcomesAndScores,
    on_gamma: Callable[[int], None] | None = None,
    *,
    max_mapped: int = MAX_MAPPED,
) -> SettingsMap:
    """Cluster the scenarios of an analysis with each setting of a grid, from the stored distances.

    The clusters are the same as `analyze` finds with the same settings. An analysis with landmarks is represented by
    its landmarks. Any other analysis of more than `max_mapped` scenarios is represented by a random sample; the
    clusters are then approximate, and min_samples is reduced in proportion to the sample. `on_gamma` is called with the
    number of values of gamma done so far.
    """
    distances, rows = _sampled_distances(study, analysis, max_mapped)
    order = canonical_order(distances)
    scaled = distances[np.ix_(order, order)] / (analysis.clustering.scale or 1.0)
    # With landmarks, `analyze` clusters only the landmarks, and all of them are on the map.
    has_landmarks = analysis.embedding_error is not None
    share = 1.0 if has_landmarks else len(rows) / len(analysis.ids)
    neighbours = choose_min_samples_values(len(rows) if has_landmarks else len(analysis.ids))
    cells = _SettingScorer(scaled, observed.select(analysis.ids[rows[order]]), share)
    labels = np.empty((len(neighbours), len(GAMMAS), len(EPS), len(rows)), dtype=np.int64)
    scores: dict[str, FloatArray] = {name: np.full(labels.shape[:3], math.nan) for name in cells.score_names}
    embeddings = np.empty((len(GAMMAS), len(rows), N_COMPONENTS))
    with single_threaded_blas():
        for g, gamma in enumerate(GAMMAS):
            embedding = KernelPca(gamma, N_COMPONENTS).fit(scaled).embedding
            embeddings[g, order] = embedding
            for m, count in enumerate(neighbours):
                for e, eps in enumerate(EPS):
                    cell_labels = cells.cluster(embedding, eps, count)
                    labels[m, g, e, order] = cell_labels
                    for name, value in cells.score(cell_labels, gamma, eps, count).items():
                        scores[name][m, g, e] = value
            if on_gamma:
                on_gamma(g + 1)
    return SettingsMap(
        rows=rows,
        gammas=GAMMAS,
        eps=EPS,
        min_samples=neighbours,
        labels=labels,
        embeddings=embeddings,
        n_clusters=labels.max(axis=-1, initial=NOISE_LABEL) + 1,
        noise=(labels == NOISE_LABEL).mean(axis=-1),
        stability=scores.pop(_STABILITY),
        agreement=scores.pop(_AGREEMENT),
        explained={name.removeprefix(_EXPLAINED): values for name, values in scores.items()},
    )


def _sampled_distances(study: StudyFile, analysis: Analysis, max_mapped: int) -> tuple[FloatArray, IntArray]:
    """Return the distances between at most `max_mapped` scenarios of an analysis, and the rows of these scenarios.

    If the analysis has landmarks (scenarios that were all compared with each other), all landmarks are returned.
    """
    if analysis.embedding_error is not None:
        return read_landmark_distances(study, analysis.by), np.asarray(analysis.clustering.landmarks)
    rows = np.arange(len(analysis.ids))
    if len(rows) > max_mapped:
        rows = np.sort(np.random.default_rng(0).choice(rows, max_mapped, replace=False))
    return np.asarray(read_distances(study, analysis.by)[np.ix_(rows, rows)]), rows


class _SettingScorer:
    """Clusters and scores for single settings of the map; each setting is a cell of the map.

    `scaled`, shape (n, n), are the distances between the n scenarios on the map, divided by the median distance of the
    analysis. `observed` are outcomes and scores of these n scenarios. `share` is n divided by the number of scenarios
    that the analysis clustered.
    """

    def __init__(self, scaled: FloatArray, observed: OutcomesAndScores, share: float) -> None:
        self._observed, self._share = observed, share
        self._stability = StabilityScorer(scaled, np.arange(len(scaled)), method="dbscan", max_part_size=len(scaled))
        self._scored: dict[bytes, dict[str, float]] = {}

    @property
    def score_names(self) -> list[str]:
        """Names of the scores."""
        return [_STABILITY, _AGREEMENT, *(_EXPLAINED + name for name in self._observed.scores)]

    def cluster(self, embedding: FloatArray, eps: float, min_samples: int) -> IntArray:
        """Return the clusters with one setting, shape (n,), from the coordinates of the scenarios in kernel space."""
        return cluster_by_density(embedding, eps, self._sampled_min_samples(min_samples), "dbscan")

    def score(self, labels: IntArray, gamma: float, eps: float, min_samples: int) -> dict[str, float]:
        """Return the scores of the clusters of one setting, by name of the score.

        There is no stability if all scenarios are in one cluster or all are noise.
        """
        # Many settings find the same clusters.
        key = labels.tobytes()
        if key not in self._scored:
            self._scored[key] = self._compare_with_observed(labels)
        # With a single group, each part has the adjusted Rand index 1 or 0.
        if labels.min() == labels.max():
            return self._scored[key]
        candidate = Candidate(
            gamma, eps, int(labels.max()) + 1, float(np.mean(labels == NOISE_LABEL)), math.nan, math.nan, math.nan,
            -math.inf, N_COMPONENTS, self._sampled_min_samples(min_samples),
        )  # fmt: skip
        return {_STABILITY: self._stability.mean_rand_index(candidate, labels), **self._scored[key]}

    def _compare_with_observed(self, labels: IntArray) -> dict[str, float]:
        from sklearn.metrics import adjusted_mutual_info_score

        outcome = self._observed.outcome
        same_end = len(outcome) == 0 or outcome.min() == outcome.max()
        agreement = math.nan if same_end else float(adjusted_mutual_info_score(outcome, labels))
        explained = {
            _EXPLAINED + name: explained_variance(scores, labels) for name, scores in self._observed.scores.items()
        }
        return {_AGREEMENT: agreement, **explained}

    def _sampled_min_samples(self, min_samples: int) -> int:
        """Return `min_samples` for the scenarios on the map: reduced in proportion, as a sample is less dense."""
        return max(min(3, min_samples), round(min_samples * self._share))
