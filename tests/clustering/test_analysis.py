"""What `analyze` finds, stored in a study and read back."""

from __future__ import annotations

import json
import shutil
import sqlite3
from dataclasses import asdict, fields, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.distance import pdist, squareform

from conftest import at_night
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.memory import DEFAULT_MEMORY, MemoryLimit
from cornercase.clustering import (
    Candidate,
    ScenarioClustering,
    analyze,
    read_analyses,
    read_analysis,
    read_distances,
)
from cornercase.clustering._agreement import compare_clusterings
from cornercase.clustering._analyze import _analyze_by_aspects, _require_memory
from cornercase.study import StudyFile
from helpers.checksums import reseal
from helpers.synthetic_study import Synthetic, explorer, opened


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    file = tmp_path_factory.mktemp("explored") / "s.db"
    with opened(file) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    return file


@pytest.fixture
def path(explored, tmp_path):
    return shutil.copy(explored, tmp_path / "s.db")


@pytest.fixture(scope="module")
def analyzed(explored):
    file = shutil.copy(explored, explored.with_name("analyzed.db"))
    analyze(file, "distance", gamma=4.0, eps=0.2, min_samples=3)
    return file


def same(one, two):
    if isinstance(one, np.ndarray):
        np.testing.assert_array_equal(one, two)
        assert one.dtype == two.dtype
    elif isinstance(one, tuple) and one and hasattr(one[0], "__dataclass_fields__"):
        assert repr([asdict(each) for each in one]) == repr([asdict(each) for each in two])
    elif hasattr(one, "__dataclass_fields__"):
        assert type(one) is type(two)
        for field in fields(one):
            same(getattr(one, field.name), getattr(two, field.name))
    else:
        assert one == two


def test_an_analysis_is_read_back_as_it_was_written(path):
    found = analyze(path)
    with StudyFile.open(path, readonly=True) as study:
        again = read_analyses(study)
        distances = read_distances(study, "distance")
        rows = [row.id for row in study.finished_rows()]
    assert list(found) == list(again) == ["ego-trajectory", "bearing", "interaction", "distance", "wttc"]
    for name, one in found.items():
        same(one, again[name])
        assert one.by == name
        assert one.ids.tolist() == rows == one.fitted_ids.tolist()
        assert sum(one.sizes) + (one.labels < 0).sum() == len(rows)
        assert [profile.cluster for profile in one.profiles if profile.cluster >= 0] == list(range(len(one.sizes)))
    assert f"by distance: {len(rows)} scenarios" in repr(found["distance"])
    assert distances.shape == (len(rows), len(rows))


def test_the_distances_are_those_of_the_aspect(path):
    with StudyFile.open(path, readonly=False) as study:
        analyze(study, "distance")
        # The course of the synthetic scenarios is constant, at five instants.
        levels = np.array([[study.course(row.id, "distance")[0]] for row in study.finished_rows()])
        expected = squareform(pdist(5 * np.minimum(levels, 100.0)))
        # Distances are computed in single precision.
        np.testing.assert_allclose(read_distances(study, "distance"), expected, rtol=1e-6, atol=1e-5)


def test_landmarks_are_read_back_and_are_still_those_after_others_joined(path):
    with opened(path) as study:
        # The study has too few scenarios for landmarks, unless they are asked for.
        before = _analyze_by_aspects(
            study,
            ["distance"],
            ScenarioClustering(landmarks=15),
            window=None,
            keep_clusters=False,
            memory_limit=MemoryLimit.from_value(DEFAULT_MEMORY),
            client=None,
            progress=False,
        )["distance"]
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
        after = analyze(study, "distance", keep_clusters=True)["distance"]
        same(after, read_analysis(study, "distance"))
    assert len(before.clustering.landmarks) == 15
    assert len(after.ids) > len(before.ids)
    assert after.fitted_ids.tolist() == before.ids.tolist()
    spanning = [one.ids[one.clustering.landmarks].tolist() for one in (before, after)]
    assert spanning[0] == spanning[1]


def test_the_study_tells_how_each_scenario_ended(path):
    analyze(path, "distance")
    with StudyFile.open(path, readonly=True) as study:
        ends = study.outcomes()
        assert list(ends) == [row.id for row in study.finished_rows()]
        # Both stand, one in front of the other.
        assert set(ends.values()) == {"B ahead"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"by": "distanc"}, "`by` distanc: .* did you mean 'distance'"),
        ({"by": ["distance", "pet"]}, "`by` pet: "),
        ({"by": 3}, "`by` 3: give a list of texts"),
        ({"gamma": -1.0}, "`gamma` -1.0: give a number above 0"),
        ({"method": "dbscn"}, "`method` dbscn: did you mean 'dbscan'"),
    ],
)
def test_refuses_before_it_begins(path, options, words):
    with pytest.raises(InputError, match=words):
        analyze(path, **options)
    with StudyFile.open(path, readonly=True) as study:
        assert study.analyzed_aspects() == []


@pytest.mark.parametrize("wrong", [None, 3])
def test_what_is_no_study_is_refused(wrong):
    with pytest.raises(InputError, match=r"`study` .*: give the path of a file"):
        analyze(wrong)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda told: told[0].update(cluster=77), "profiles of other clusters"),
        (lambda told: told[0].update(size=1), "profiles of other clusters"),
        (lambda told: told.pop(), "profiles of other clusters"),
        (lambda told: told.append(told[0]), "profiles of other clusters"),
        (lambda told: told[0].update(name=None), "Profile has 'None' as its name"),
        (lambda told: told[0].update(name=["Ego"]), r"Profile has .* as its name"),
        (lambda told: told[0].update(true_of="all"), "Profile has 'all' as its true_of"),
        (lambda told: told[0].update(example=0), "an example that is not a scenario"),
        (lambda told: told[0].update(outcomes={"Ego first": -1}), "a negative number of scenarios"),
        (lambda told: told[0].update(more=1), "unexpected keyword argument 'more'"),
    ],
)
def test_profiles_that_were_changed_by_hand_are_refused_in_a_sentence(analyzed, tmp_path, change, words):
    path = shutil.copy(analyzed, tmp_path / "s.db")
    with sqlite3.connect(path) as connection:
        ((info,),) = connection.execute("SELECT info FROM analyses").fetchall()
        changed = json.loads(info)
        assert len(changed["profiles"]) > 1
        change(changed["profiles"])
        connection.execute("UPDATE analyses SET info = ?", (json.dumps(changed),))
    connection.close()
    reseal(path)
    with (
        StudyFile.open(path, readonly=True) as study,
        pytest.raises(InputError, match=f"s.db: cannot be used as a study .*{words}"),
    ):
        read_analysis(study, "distance")


@pytest.mark.parametrize("setting", [{"gamma": 2.0}, {"eps": 0.1}, {"min_samples": 3}, {"window": 1.0}])
@pytest.mark.parametrize("method", at_night(["dbscan", "hdbscan"], {"hdbscan"}))
def test_kept_clusters_keep_their_settings(path, setting, method):
    analyze(path, "distance", method=method)
    for given in (setting, {"method": "hdbscan"}, {"method": "dbscan"}):
        with pytest.raises(InputError, match=f"leave out .*`{next(iter(given))}`"):
            analyze(path, "distance", **given, keep_clusters=True)
    # All settings apply to aspects that are clustered for the first time.
    assert analyze(path, "wttc", method="hdbscan", keep_clusters=True)["wttc"].clustering.method == "hdbscan"


@pytest.mark.parametrize("eps", [10.0, 1e-9])
def test_one_group_and_noise_alone_have_no_stability(path, eps):
    found = analyze(path, "distance", gamma=0.25, eps=eps, min_samples=3)["distance"].clustering
    assert len(np.unique(found.labels)) == 1
    tried = Candidate(found.gamma, found.eps, found.n_clusters, found.noise, np.nan, np.nan, 1.0, 1.0)
    # Every part is one group, or noise, too.
    assert replace(found, candidates=(tried,)).stability is None
    labels = np.arange(len(found.labels)) % 2 - 1
    assert replace(found, candidates=(tried,), labels=labels).stability == 1.0


@pytest.mark.parametrize(
    ("budget", "survives", "words"),
    [
        (0, 0, "no scenario was run; clustering needs at least 2"),
        (1, 1, "1 scenario was run; clustering needs at least 2"),
        (9, 1, "1 scenario was run, 8 failed, the first one with: too slow; clustering needs at least 2"),
        (9, 0, "no scenario was run, 9 failed, the first one with: too slow; clustering needs at least 2"),
    ],
)
def test_too_few_scenarios_are_refused_with_the_reason(tmp_path, budget, survives, words):
    class Slow(Synthetic):
        def run(self, concretes):
            for outcome in super().run(concretes):
                yield outcome if self.ran <= survives else SimulationError("too slow")

    with opened(tmp_path / "s.db") as study:
        if budget:
            explorer(study, Slow(), metrics=("distance", "wttc"), optimizer="sobol", budget=budget).run()
        with pytest.raises(InputError, match=words):
            analyze(study)


def test_what_divides_nothing_agrees_with_nothing_else_that_divides_nothing(path):
    analyze(path, "distance", gamma=4.0, eps=0.2, min_samples=3)
    analyze(path, ["wttc", "ego-speed"], gamma=0.25, eps=10.0, min_samples=3)
    with StudyFile.open(path, readonly=True) as study:
        assert [len(one.sizes) > 1 for one in read_analyses(study).values()] == [False, True, False]
        assert set(compare_clusterings(study)) == {("ego-speed", "distance"), ("distance", "wttc")}


@pytest.mark.parametrize(("count", "aspects", "taken"), [(2000, 5, "982 MB"), (2000, 1, "697 MB"), (1500, 5, "691 MB")])
def test_less_memory_than_analyze_was_seen_to_take_is_refused(count, aspects, taken):
    study: Any = SimpleNamespace(path="study.db")
    with pytest.raises(InputError, match=f"the series of {count} scenarios need up to"):
        _require_memory(study, {}, aspects, count, MemoryLimit.from_value(taken))
