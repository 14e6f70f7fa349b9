from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from lxml import etree
from scipy.stats import qmc

from conftest import EXAMPLES, ran
from cornercase.drivers._resolve import driver_by_name
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.metrics import METRICS
from cornercase.scenario._xml import read_xml
from cornercase.simulators import Builtin
from cornercase.study import StudyFile


@pytest.mark.parametrize("name", ["x_intersection", "t_intersection"])
def test_examples_are_valid_openscenario(name):
    import qc_openscenario

    schema = Path(qc_openscenario.__file__).parent / "schema" / "1.2.0" / "OpenSCENARIO.xsd"
    validator = etree.XMLSchema(etree.parse(schema))
    for file in (f"{name}.xosc", f"{name}.space.xosc"):
        validator.assertValid(read_xml(EXAMPLES / name / file).getroottree())


def sample(logical, simulator, size):
    points = logical.space.snap(qmc.Sobol(3, rng=np.random.default_rng(1)).random(size))
    return points, ran(simulator, [logical.concrete_scenario(one) for one in logical.space.values(points)])


def outcome(recording, other):
    """Return who is first where their paths cross: the ego, the other, or a collision."""
    if recording.first_collision("Ego", other) is not None:
        return "collision"
    a, b = recording.box_center("Ego"), recording.box_center(other)
    gaps = np.hypot(*(a[:, None] - b[None]).transpose(2, 0, 1))
    i, j = np.unravel_index(np.argmin(gaps), gaps.shape)
    return "ego first" if i < j else "other first"


@pytest.mark.parametrize(("example", "other"), [("x_intersection", "Pedestrian"), ("t_intersection", "C")])
def test_every_outcome_occurs(example, other, request):
    _, recordings = sample(request.getfixturevalue(example), Builtin(), 256)
    assert {outcome(recording, other) for recording in recordings} == {"ego first", "other first", "collision"}
    assert max(recording.time[-1] for recording in recordings) < 40


def test_speed_of_the_car_has_next_to_no_influence_on_the_x_intersection(x_intersection):
    # Total sensitivity indices by Jansen's estimator: Saltelli et al. 2010, table 2, (f).
    size, metric = 128, METRICS.create("wttc")
    base = qmc.Sobol(6, rng=np.random.default_rng(3)).random(size)
    a, b = base[:, :3], base[:, 3:]
    mixed = [np.where(np.arange(3) == j, b, a) for j in range(3)]
    points = np.concatenate([a, *mixed])
    concretes = [x_intersection.concrete_scenario(one) for one in x_intersection.space.values(points)]
    courses = [metric.course(one, "Ego", "Pedestrian") for one in ran(Builtin(), concretes)]
    scores = np.array([metric.score(course) for course in courses])
    f, others = scores[:size], scores[size:].reshape(3, size)
    total = dict(zip(x_intersection.space.names, 0.5 * ((others - f) ** 2).mean(axis=1) / f.var(), strict=True))
    assert total["p1_speed"] < 0.1
    assert total["ego_start"] > 0.3
    assert total["pedestrian_wait"] > 0.3


@pytest.fixture(scope="module")
def x_study(tmp_path_factory):
    path = tmp_path_factory.mktemp("x") / "study.db"
    explore_config(paper_experiment_config("x-intersection", budget=120, seed=0), path)
    return path


def test_critical_scenarios_lie_along_a_diagonal(x_study):
    with StudyFile.open(x_study, readonly=True) as study:
        points, scores = study.points(), study.scores("wttc")
    start, wait = points[scores < 0.1, :2].T
    assert len(start) >= 20
    assert np.corrcoef(start, wait)[0, 1] < -0.95
    assert np.ptp(start) > 0.5
    assert scores[(points[:, 0] < 0.4) & (points[:, 1] < 0.4)].min() > 0.3


def test_clusters_by_wttc_separate_high_from_low_criticality(x_study):
    from cornercase.clustering import analyze

    with StudyFile.open(x_study, readonly=False) as study:
        # WTTC changes gradually from critical to harmless: one cluster; manual settings as in the paper split it.
        labels = analyze(study, ["wttc"], gamma=1.0, eps=0.2)["wttc"].clustering.labels
        scores = study.scores("wttc")
    medians = [np.median(scores[labels == k]) for k in range(labels.max() + 1)]
    assert len(medians) >= 2
    harmless = scores[labels == int(np.argmax(medians))]
    # The least critical cluster contains no critical scenario; they are in other clusters.
    assert harmless.min() > 0.5
    assert np.min(medians) < 0.3
    assert np.median(harmless) > 5 * np.min(medians)


@pytest.mark.slow
def test_accidents_form_clusters_of_their_own_by_ego_trajectory(tmp_path):
    from cornercase.clustering import analyze

    path = tmp_path / "study.db"
    explore_config(paper_experiment_config("t-intersection", budget=100, seed=0), path)
    with StudyFile.open(path, readonly=False) as study:
        labels = analyze(study, ["ego-trajectory"])["ego-trajectory"].clustering.labels
        crashed = np.array([bool(study.recording(row.id).collisions) for row in study.finished_rows()])
    assert 0 < crashed.sum() < len(crashed)
    # One or more: being hit from behind and being hit while standing are two types of accident.
    clustered = labels >= 0
    assert (crashed & clustered).sum() >= 0.9 * crashed.sum()
    for cluster in set(labels[crashed & clustered].tolist()):
        assert crashed[labels == cluster].all()


def test_the_more_aggressive_the_ego_the_more_collisions(t_intersection):
    collisions = []
    for preset in ("cautious", "normal", "aggressive"):
        simulator = Builtin(on_collision="stop", drivers={"Ego": driver_by_name(preset)})
        _, recordings = sample(t_intersection, simulator, 256)
        collisions.append(sum(bool(recording.collisions) for recording in recordings))
    assert collisions[0] < collisions[1] < collisions[2]
    assert collisions[2] >= 10
