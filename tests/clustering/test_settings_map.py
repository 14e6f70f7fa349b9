"""The map over gamma and eps says what `analyze` would find with each setting."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from sklearn.cluster import DBSCAN
from sklearn.metrics import adjusted_mutual_info_score

from cornercase.clustering import _analyze as analyze_module
from cornercase.clustering import _landmarks as landmarks
from cornercase.clustering import analyze, cluster, read_analysis, read_distances
from cornercase.clustering._settings_map import (
    EPS,
    GAMMAS,
    OutcomesAndScores,
    choose_min_samples_values,
    compute_settings_map,
)
from cornercase.study import StudyFile
from helpers.synthetic_study import explorer, opened


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    file = tmp_path_factory.mktemp("settings") / "s.db"
    with opened(file) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    analyze(file, "distance")
    return file


@pytest.fixture(scope="module")
def mapped(path):
    with StudyFile.open(path, readonly=True) as study:
        analysis = read_analysis(study, "distance")
        observed = OutcomesAndScores.from_study(study)
        return (
            compute_settings_map(study, analysis, observed),
            read_distances(study, "distance"),
            study.scores("distance"),
        )


def test_a_cell_has_the_clusters_that_analyze_finds_with_its_setting(mapped):
    found, distances, _ = mapped
    for (m, points), (g, gamma), (e, eps) in itertools.product(
        enumerate(found.min_samples), list(enumerate(GAMMAS))[::5], list(enumerate(EPS))[::4]
    ):
        labels = cluster(distances, gamma=gamma, eps=eps, min_samples=points).labels
        np.testing.assert_array_equal(found.labels[m, g, e], labels)
        assert found.n_clusters[m, g, e] == labels.max() + 1
        assert found.noise[m, g, e] == pytest.approx((labels < 0).mean())


def test_the_picture_of_a_cell_is_where_its_clusters_were_found(mapped):
    found, _, _ = mapped
    for g, e in itertools.product(range(0, len(GAMMAS), 4), range(0, len(EPS), 3)):
        own = DBSCAN(eps=EPS[e], min_samples=found.min_samples[0]).fit_predict(found.embeddings[g])
        assert (own < 0).tolist() == (found.labels[0, g, e] < 0).tolist()
        assert own.max() == found.labels[0, g, e].max()


def test_explained_variance_is_that_between_the_clusters(mapped):
    found, _, scores = mapped
    labels = found.labels[0, 3, 5]
    assert len(set(labels.tolist())) > 1
    within = sum(((scores[labels == c] - scores[labels == c].mean()) ** 2).sum() for c in set(labels.tolist()))
    assert found.explained["distance"][0, 3, 5] == pytest.approx(1 - within / ((scores - scores.mean()) ** 2).sum())


def test_what_says_nothing_has_no_number(mapped):
    found, _, _ = mapped
    single = np.array([len(set(one.tolist())) == 1 for one in found.labels.reshape(-1, found.labels.shape[-1])])
    assert 0 < single.sum() < single.size
    # A single group is found again by construction; all of these scenarios end in the same way.
    np.testing.assert_array_equal(np.isnan(found.stability).ravel(), single)
    assert np.isnan(found.agreement).all()


def test_agreement_is_with_the_outcome(path, mapped):
    found, _, _ = mapped
    with StudyFile.open(path, readonly=True) as study:
        analysis = read_analysis(study, "distance")
        outcome = (study.scores("distance") > 3.0).astype(np.int64)
        observed = OutcomesAndScores(analysis.ids, outcome, ("near", "far"), {})
        again = compute_settings_map(study, analysis, observed)
    labels = found.labels[1, 4, 4]
    assert again.agreement[1, 4, 4] == pytest.approx(adjusted_mutual_info_score(outcome, labels))
    assert again.explained == {}


def test_it_is_the_same_again(path, mapped):
    with StudyFile.open(path, readonly=True) as study:
        again = compute_settings_map(study, read_analysis(study, "distance"), OutcomesAndScores.from_study(study))
    for name in ("labels", "embeddings", "stability", "rows"):
        np.testing.assert_array_equal(getattr(again, name), getattr(mapped[0], name))


def test_of_many_scenarios_a_sample_is_taken(path):
    with StudyFile.open(path, readonly=True) as study:
        analysis = read_analysis(study, "distance")
        found = compute_settings_map(study, analysis, OutcomesAndScores.from_study(study), max_mapped=20)
    assert len(found.rows) == 20 < len(analysis.ids)
    assert found.labels.shape == (len(found.min_samples), len(GAMMAS), len(EPS), 20)
    assert found.min_samples == choose_min_samples_values(len(analysis.ids))


def test_of_landmarks_all_are_taken(path, tmp_path, monkeypatch):
    monkeypatch.setattr(analyze_module, "MAX_ALL_PAIRS", 30)
    monkeypatch.setattr(landmarks, "N_LANDMARKS", 24)
    file = tmp_path / "s.db"
    file.write_bytes(path.read_bytes())
    analyze(file, "distance")
    with StudyFile.open(file, readonly=True) as study:
        analysis = read_analysis(study, "distance")
        found = compute_settings_map(study, analysis, OutcomesAndScores.from_study(study))
    np.testing.assert_array_equal(found.rows, analysis.clustering.landmarks)
    at = found.min_samples.index(3), GAMMAS.index(1.0), EPS.index(0.2)
    analyze(file, "distance", gamma=1.0, eps=0.2, min_samples=3)
    with StudyFile.open(file, readonly=True) as study:
        labels = read_analysis(study, "distance").labels[found.rows]
    # By size among all, clusters may have other numbers than among the landmarks.
    pairs = set(zip(labels.tolist(), found.labels[at].tolist(), strict=True))
    assert len(pairs) == len({one for one, _ in pairs}) == len({other for _, other in pairs})
