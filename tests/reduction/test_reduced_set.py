"""Reduced sets of a given size or coverage."""

from __future__ import annotations

import json
import shutil
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from conftest import examples
from cornercase._common.errors import InputError
from cornercase.clustering import read_analyses, read_distances
from cornercase.clustering._headline_aspect import find_headline_aspect
from cornercase.evidence._criticality_bands import bands_by_scenario
from cornercase.reduction import read_reduction, reduce
from cornercase.reduction._coverage import measure_coverage
from cornercase.reduction._medoids import find_k_medoids
from cornercase.reduction.selection._greedy import select_scenarios
from cornercase.reduction.selection._select import SelectionInput, SelectionRequest, select_reduced_set
from cornercase.report import summarize
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, cornercase


def two_clusters(count=120, seed=0):
    """Points of two equally large clusters and three outliers, with distances by position and by one coordinate."""
    rng = np.random.default_rng(seed)
    half = (count - 3) // 2
    points = np.concatenate([0.3 * rng.random((half, 3)), 0.7 + 0.3 * rng.random((half, 3)), rng.random((3, 3))])
    labels = np.repeat([0, 1, -1], [half, half, 3])
    return points, [cdist(points, points), cdist(points[:, :1], points[:, :1])], labels


@given(size=st.integers(1, 40), seed=st.integers(0, 5))
@settings(max_examples=examples(30), deadline=None)
def test_it_has_the_size_that_is_asked_for_and_nothing_twice(size, seed):
    points, distances, labels = two_clusters(seed=seed)
    kept = select_scenarios(points, distances, labels, size=size)
    assert len(kept) == len({one.index for one in kept}) == size
    assert all(one.cluster == labels[one.index] for one in kept)
    assert select_scenarios(points, distances, labels, size=size) == kept


def test_critical_clusters_come_first_and_have_more_archetypes():
    points, distances, labels = two_clusters()
    kept = select_scenarios(points, distances, labels, critical_clusters=[1], size=16)
    assert [(one.cluster, one.role) for one in kept[:2]] == [(1, "prototype"), (0, "prototype")]
    archetypes = [one.cluster for one in kept if one.role == "archetype"]
    assert (archetypes.count(1), archetypes.count(0)) == (2, 1)
    assert sum(one.role == "gap" for one in kept) == 11


@pytest.mark.parametrize("size", [1, 2, 5, 16])
def test_a_set_begins_with_what_represents_the_critical_scenarios(size):
    points, distances, labels = two_clusters()
    # Neither prototype is critical: those of cluster 1 at its edge, and a few of cluster 0.
    critical = (labels == 1) & (points[:, 0] > 0.93)
    critical[np.flatnonzero(labels == 0)[points[labels == 0][:, 0] < 0.02]] = True
    assert critical[labels == 1].sum() > critical[labels == 0].sum() > 0
    chosen = SelectionInput(points, distances, labels, points, [], critical)
    kept, _ = select_reduced_set(chosen, SelectionRequest(size, None, None, "auto"))
    assert len(kept) == size
    assert [(one.cluster, one.role) for one in kept[:2]] == [(1, "critical prototype"), (0, "critical prototype")][
        :size
    ]
    represents = [one for one in kept if one.role != "gap"]
    assert kept[: len(represents)] == tuple(represents)
    is_critical = [bool(critical[one.index]) for one in represents]
    assert is_critical == sorted(is_critical, reverse=True)
    # Each cluster without a critical scenario is represented before another one is twice.
    critical[labels == 0] = False
    kept, _ = select_reduced_set(chosen, SelectionRequest(2, None, None, "auto"))
    assert [(one.cluster, one.role) for one in kept] == [(1, "critical prototype"), (0, "prototype")]


def test_critical_scenarios_that_no_cluster_has_are_represented_too():
    points, distances, labels = two_clusters()
    kept, _ = select_reduced_set(
        SelectionInput(points, distances, labels, points, [], labels == -1), SelectionRequest(5, None, None, "auto")
    )
    assert (kept[0].cluster, kept[0].role) == (-1, "critical prototype")
    assert [(one.cluster, one.role) for one in kept[1:3]] == [(0, "prototype"), (1, "prototype")]


def test_critical_clusters_are_covered_more_closely():
    points, distances, labels = two_clusters(300)
    left = []
    for critical in ([0], [1]):
        kept = [one.index for one in select_scenarios(points, distances, labels, critical, size=30)]
        left.append(distances[0][labels == 1][:, kept].min(axis=1).mean())
    assert left[1] < 0.95 * left[0]


def test_each_that_fills_a_gap_is_where_it_leaves_least():
    points, distances, labels = two_clusters(60)
    kept = [one.index for one in select_scenarios(points, distances[:1], labels, size=12)]

    def left(indices):
        return (distances[0][:, indices].min(axis=1) ** 3).sum()

    gaps = [k for k, one in enumerate(select_scenarios(points, distances[:1], labels, size=12)) if one.role == "gap"]
    assert gaps
    for k in gaps:
        for other in range(len(points)):
            assert left([*kept[:k], other, *kept[k + 1 :]]) >= left(kept) * (1.0 - 1e-6)


@pytest.mark.parametrize("cover", [0.4, 0.2, 0.1])
def test_a_coverage_is_reached_in_every_clustering_and_noise_counts(cover):
    points, distances, labels = two_clusters()
    kept = [one.index for one in select_scenarios(points, distances, labels, cover=cover)]
    for matrix in distances:
        assert matrix[:, kept].min(axis=1).max() <= cover * matrix.max() + 1e-12
    # With one less, some scenario is similar to none by both.
    apart = np.maximum(*(m / m.max() for m in distances))
    assert apart[:, kept[:-1]].min(axis=1).max() > cover


def test_what_is_alike_is_kept_once():
    points, distances, labels = two_clusters(23)
    twice = np.concatenate([np.arange(23)] * 2)
    kept = select_scenarios(points[twice], [m[np.ix_(twice, twice)] for m in distances], labels[twice], size=46)
    assert len(kept) == 23


def test_medoids_leave_nearly_the_smallest_mean_there_is():
    rng = np.random.default_rng(3)
    for _ in range(10):
        points = rng.random((14, 2))
        distances = cdist(points, points)
        found = find_k_medoids(distances, 3)
        best = min(distances[:, list(each)].min(axis=1).mean() for each in combinations(range(14), 3))
        assert distances[:, found].min(axis=1).mean() <= 1.25 * best
    blobs = np.concatenate([0.01 * rng.random((10, 2)) + place for place in ((0, 0), (1, 0), (0, 1))])
    assert (find_k_medoids(cdist(blobs, blobs), 3) // 10).tolist() == [0, 1, 2]
    assert find_k_medoids(np.zeros((4, 4)), 4).tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "give exactly one of them"),
        ({"size": 3, "cover": 0.1}, "give exactly one of them"),
        ({"size": 0}, "selects nothing"),
        ({"cover": 2.0}, "`cover` 2: give a number"),
    ],
)
def test_refuses_in_one_sentence(options, words):
    with pytest.raises(InputError, match=words):
        select_scenarios(*two_clusters(), **options)


def test_the_command_line_keeps_as_many_as_it_is_told(tmp_path):
    study = tmp_path / "s.db"
    common = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--budget", "24"]
    assert cornercase("explore", X, "--space", SPACE, *common, "-o", study).returncode == 0
    assert cornercase("analyze", study, "--by", "wttc").returncode == 0
    for k, (option, count) in enumerate(((["--size", "9"], 9), (["--share", "0.25"], 6))):
        done = cornercase("reduce", study, *option, "-o", tmp_path / str(k))
        assert done.returncode == 0, done.stderr
        manifest = json.loads((tmp_path / str(k) / "manifest.json").read_text())
        assert manifest["kept"] == len(manifest["scenarios"]) == count
        assert "gap" in {one["role"] for one in manifest["scenarios"]}
        assert len(list((tmp_path / str(k)).glob("*.xosc"))) == count
    done = cornercase("reduce", study, "--cover", "0.3", "-o", tmp_path / "c")
    assert done.returncode == 0, done.stderr
    covered = json.loads((tmp_path / "c" / "manifest.json").read_text())["coverage"]
    assert max(one["largest_relative"] for one in covered.values()) <= 0.3
    for option in (["--size", "3", "--cover", "0.1"], ["--share", "1.5"], ["--size", "3", "--archetypes", "2"]):
        assert cornercase("reduce", study, *option, "-o", tmp_path / "x").returncode == 2
    for option, words in (
        (["--within", "0"], "give a number above 0"),
        (["--archetypes-by", "hul"], "did you mean 'hull'"),
    ):
        done = cornercase("reduce", study, *option, "-o", tmp_path / "x")
        assert (done.returncode, words in done.stderr) == (2, True), done.stderr
    assert not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    "wrong",
    [
        {"size": 2.5}, {"size": "3"}, {"size": True}, {"share": "x"}, {"share": float("nan")}, {"cover": "x"},
        {"within": "x"}, {"within": None}, {"archetypes_by": None}, {"by": ["wttc"]}, {"folder": None}, {"folder": 3},
    ],
)  # fmt: skip
def test_what_has_another_type_is_refused(wrong, tmp_path):
    (name,) = wrong
    with pytest.raises(InputError, match=f"^`{name}` .*: give "):
        reduce(**{"study": tmp_path / "s.db", "folder": tmp_path / "reduced", **wrong})
    assert not list(tmp_path.iterdir())


def test_a_file_in_the_way_of_the_folder_is_said(tmp_path):
    (tmp_path / "file").write_text("")
    for folder in ("file", "file/below/it"):
        with pytest.raises(InputError, match=r"^`folder` .*file is a file, not a folder; choose another name"):
            reduce(tmp_path / "s.db", tmp_path / folder)


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    """Study of 80 scenarios of the X-intersection, analysed, reduced and reported, and its folder."""
    folder = tmp_path_factory.mktemp("explored")
    study = folder / "s.db"
    common = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--critical", "0.5"]
    for command in (
        ["explore", X, "--space", SPACE, *common, "--budget", "80", "-o", study],
        ["analyze", study],
        ["reduce", study, "-o", folder / "reduced"],
        ["report", study, "-o", folder / "r.html"],
    ):
        done = cornercase(*command)
        assert done.returncode == 0, done.stderr
    return folder, json.loads((folder / "reduced" / "manifest.json").read_text())


def test_a_tenth_is_kept_and_leaves_less_of_others_than_random_choices(explored):
    folder, manifest = explored
    assert manifest["kept"] == 8
    with StudyFile.open(folder / "s.db", readonly=True) as study:
        for name, analysis in read_analyses(study).items():
            kept = analysis.rows_of([one["id"] for one in manifest["scenarios"]])
            found = measure_coverage(read_distances(study, name), kept, ids=analysis.ids)
            told = manifest["coverage"][name]
            assert (told["worst"], told["largest"]) == (found.worst, pytest.approx(found.largest))
            # Held-out distances are larger, and still smaller than for random selections.
            held_out = told["held_out"]
            assert held_out["scenarios"] == 80
            assert held_out["mean"] > 1.1 * told["mean"]
            assert held_out["better_largest"] >= 0.9
            assert held_out["better_mean"] >= 0.9


def test_python_gets_what_the_manifest_says_and_reads_it_back(explored, tmp_path):
    folder, manifest = explored
    path = shutil.copy(folder / "s.db", tmp_path / "s.db")
    reduced = reduce(path, tmp_path / "again")
    assert json.loads((tmp_path / "again" / "manifest.json").read_text()) == manifest
    assert (len(reduced), reduced.n_run) == (8, 80)
    # The kinds that the page headlines, though wttc was searched: it puts all scenarios in one cluster.
    assert reduced.by == find_headline_aspect(summarize(path).analyses) != "wttc"
    by_role = {scenario.role: scenario for scenario in reduced.scenarios}
    prototype, critical = by_role["prototype"], by_role["critical prototype"]
    assert prototype.why == f"the scenario most like all others of {reduced.by} {prototype.cluster}"
    assert critical.why == f"the scenario most like the critical ones of {reduced.by} {critical.cluster}"
    assert reduced.ids == [one["id"] for one in manifest["scenarios"]]
    assert [one.why for one in reduced.scenarios] == [one["why"] for one in manifest["scenarios"]]
    assert reduced.coverage["wttc"].medoids_mean == manifest["coverage"]["wttc"]["medoids_mean"]
    assert f"8 of 80 scenarios kept by {reduced.by}" in repr(reduced)
    table = reduced._repr_html_()
    assert table.count("<tr>") == 1 + len(reduced)
    assert reduced.table().index.tolist() == reduced.ids
    assert "pedestrian_wait" in table
    with StudyFile.open(path, readonly=True) as study:
        assert read_reduction(study) == reduced


def test_the_command_says_how_many_kept_scenarios_are_dangerous(explored, tmp_path):
    path = shutil.copy(explored[0] / "s.db", tmp_path / "s.db")
    done = cornercase("reduce", path, "--size", "3", "-o", tmp_path / "few")
    assert done.returncode == 0, done.stderr
    with StudyFile.open(path, readonly=True) as study:
        reduced = read_reduction(study)
        collides = {scenario for scenario, hits in study.impacts().items() if hits}
    assert reduced is not None
    kept = reduced.scenarios
    critical = [one.scores["wttc"] <= 0.5 for one in kept]
    assert critical[0]
    n_critical, n_colliding = sum(critical), len(collides & {one.id for one in kept})
    are = "is" if n_critical == 1 else "are"
    who = "All" if n_critical == 3 else n_critical
    said = f"{who} of them {are} critical and in {n_colliding or 'none'} Ego collides."
    assert said in done.stdout
    assert said in cornercase("show", path).stdout


def test_each_band_of_criticality_is_represented(explored, tmp_path):
    path = shutil.copy(explored[0] / "s.db", tmp_path / "s.db")
    reduced = reduce(path, tmp_path / "bands", by="bands:wttc", size=6)
    with StudyFile.open(path, readonly=True) as study:
        bands, band_of = bands_by_scenario(study, "wttc")
        assert read_reduction(study) == reduced
    assert reduced.by == "bands:wttc"
    assert {band_of[scenario.id] for scenario in reduced.scenarios} == {0, 1, 2}
    prototypes = [scenario for scenario in reduced.scenarios if scenario.role == "prototype"]
    assert len(prototypes) == 3
    for scenario in prototypes:
        band = band_of[scenario.id]
        expected = f"band of {bands.names[band]} criticality by wttc: {bands.describe_range(band)}"
        assert scenario.why == f"the scenario most like all others of the {expected}"
    summary = summarize(path)
    assert summary.bands["wttc"].sizes == bands.sizes
    assert summary_to_dict(summary)["bands"]["wttc"]["high"]["scenarios"] == bands.sizes[0]
    done = cornercase("report", path, "-o", tmp_path / "r.html")
    assert done.returncode == 0, done.stderr
    with pytest.raises(InputError, match=r"bands:nope: the study has no such metric"):
        reduce(path, tmp_path / "none", by="bands:nope")


@pytest.mark.usefixtures("no_cache")
def test_another_scenario_file_than_the_one_that_was_explored_is_refused(tmp_path, monkeypatch):
    # No other copy is found from here.
    monkeypatch.chdir(tmp_path)
    source = shutil.copytree(X.parent, tmp_path / "scenario")
    study = tmp_path / "s.db"
    common = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--budget", "12"]
    space = ["--space", source / SPACE.name]
    assert cornercase("explore", source / X.name, *space, *common, "-o", study).returncode == 0
    assert cornercase("analyze", study, "--by", "wttc").returncode == 0
    original = (source / X.name).read_text()
    (source / X.name).write_text(original.replace("</OpenSCENARIO>", "<!-- another one --></OpenSCENARIO>"))
    with pytest.raises(InputError, match=f"{X.name}: .* changed since .*s.db was explored; "):
        reduce(study, tmp_path / "reduced")
    assert not (tmp_path / "reduced").exists()
    done = cornercase("reduce", study, "-o", tmp_path / "reduced")
    assert done.returncode == 2
    assert "'cornercase explore'" in done.stderr
    (source / X.name).write_text(original)
    assert len(reduce(study, tmp_path / "reduced", share=0.25)) == 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"size": 3, "share": 0.1}, "`size`, `share`, `cover`, `archetypes`: give only one of them"),
        ({"share": 1.5}, "`share` 1.5: give a number above 0 and up to 1"),
        ({"archetypes_by": "hul"}, "`archetypes_by` hul: did you mean 'hull'"),
        ({"within": 0.0}, "`within` 0: give a number above 0"),
        ({"size": 0}, "`size` 0: "),
        ({"by": "pet"}, "holds no analysis by pet, only by "),
    ],
)
def test_python_is_refused_in_one_sentence_before_anything_is_written(explored, tmp_path, options, words):
    folder, _ = explored
    with pytest.raises(InputError, match=words):
        reduce(folder / "s.db", tmp_path / "reduced", **options)
    assert not (tmp_path / "reduced").exists()


def test_the_manifest_tells_the_shape_of_each_cluster_and_what_is_unlike_all_kept(explored):
    folder, manifest = explored
    with StudyFile.open(folder / "s.db", readonly=True) as study:
        labels = study.read_analysis(manifest["by"], "labels")[0]["labels"]
    assert [one["cluster"] for one in manifest["shapes"]] == list(range(labels.max() + 1))
    for one in manifest["shapes"]:
        assert 0.0 <= one["convexity"] <= 1.0
        assert one["archetypes_by"] in ("hull", "parts", "kernel")
    assert {"ego-trajectory", "wttc"} <= set(manifest["critical"]) == set(manifest["coverage"])
    assert "judges a set that was chosen in the same way from the other four" in manifest["graded"]
    for found in manifest["critical"].values():
        assert found["within"] > 0.0
        assert all(0.0 <= found[key] <= 1.0 for key in ("critical", "boundary", "random", "medoids"))
        assert 0.0 <= found["unlike"]["low"] <= found["unlike"]["high"] <= 1.0


def test_the_page_and_the_summary_tell_it_too(explored):
    folder, _ = explored
    page = (folder / "r.html").read_text()
    for words in (
        "k-medoids",
        "stability",
        "Shapes of the clusters",
        "on the boundary",
        "better than random",
        "which the choice has not seen",
    ):
        assert words in page
    shown = cornercase("show", folder / "s.db", "--json")
    summary = json.loads(shown.stdout)
    told = summary["coverage"]["wttc"]
    # Not the in-sample figures.
    assert "random subsets with a larger mean" not in told
    assert told["held_out"]["scenarios"] == 80
    assert told["held_out"]["random_subsets_with_a_larger_mean"] >= 0.9
    assert told["critical_scenarios"]["held_out"]["critical_scenarios"] > 0
    assert "one_of_the_space_is_unlike_all_kept" in told["critical_scenarios"]
    assert summary["shapes"]["cluster_0"]["convexity"] <= 1.0


def test_reduced_twice_gives_the_same_bytes(explored):
    folder, _ = explored
    again = folder / "again"
    assert cornercase("reduce", folder / "s.db", "-o", again).returncode == 0
    first = {path.name: path.read_bytes() for path in (folder / "reduced").iterdir()}
    assert first == {path.name: path.read_bytes() for path in again.iterdir()}


def test_the_papers_way_keeps_archetypes_alone(explored):
    folder, _ = explored
    done = cornercase(
        "reduce", folder / "s.db", "--archetypes", "auto", "--archetypes-by", "hull", "-o", folder / "paper"
    )
    assert done.returncode == 0, done.stderr
    manifest = json.loads((folder / "paper" / "manifest.json").read_text())
    assert {one["role"] for one in manifest["scenarios"]} == {"prototype", "archetype"}
    assert {one["archetypes_by"] for one in manifest["shapes"]} == {"hull"}


@pytest.mark.slow
def test_how_well_it_covers_is_drawn(explored, tmp_path):
    folder, _ = explored
    done = cornercase("report", folder / "s.db", "--figures", "-o", tmp_path / "r.html")
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "r-figures" / "coverage.png").stat().st_size > 5000


@pytest.mark.slow
def test_new_scenarios_join_the_clusters_that_are_kept(explored, tmp_path):
    folder, _ = explored
    study = tmp_path / "s.db"
    study.write_bytes((folder / "s.db").read_bytes())
    with StudyFile.open(study, readonly=True) as opened:
        before = opened.read_analysis("wttc", "ids", "labels")[0]
    common = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "sobol", "--critical", "0.5"]
    assert cornercase("explore", X, "--space", SPACE, *common, "--budget", "132", "-o", study).returncode == 0
    for _ in range(2):
        done = cornercase("analyze", study, "--keep-clusters")
        assert done.returncode == 0, done.stderr
        with StudyFile.open(study, readonly=True) as opened:
            after, info = opened.read_analysis("wttc", "ids", "labels", "embedding")
        assert len(after["ids"]) == len(after["labels"]) == len(after["embedding"]) == 132
        assert after["labels"][:120].tolist() == before["labels"].tolist()
        assert set(after["labels"][120:].tolist()) <= {-1, *before["labels"].tolist()}
        assert (after["labels"][120:] >= 0).mean() > 0.5
        assert info["fitted"] == list(range(1, 121))
    assert cornercase("report", study, "-o", tmp_path / "r.html").returncode == 0
    assert "Found among 80 scenarios; 12 have joined since." in (tmp_path / "r.html").read_text()
