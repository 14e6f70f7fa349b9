"""Names of clusters are true and distinct, as derived independently from the recordings by `kind_names`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist
from scipy.stats import qmc

from conftest import EXAMPLES, at_night, ran
from cornercase.clustering import analyze
from cornercase.clustering._agreement import collect_facts, mutual_information_with_facts
from cornercase.clustering.naming._names import ClusterName, name_clusters
from cornercase.clustering.naming._predicates import NamingFacts, Predicate, predicates_with_fixed_bounds
from cornercase.drivers._resolve import driver_by_name
from cornercase.exploration import explore
from cornercase.metrics.ending._ego_features import measure_features
from cornercase.metrics.ending._find_outcome import find_outcome
from cornercase.recordings import Collision
from cornercase.scenario import LogicalScenario, Parameter, ParameterSpace
from cornercase.simulators import Builtin
from cornercase.study import StudyFile
from helpers.cluster_names import Scene, is_true, written
from helpers.encounter_recordings import CROSSES, NORTH, entity, recording, walker

NCAP = Path(__file__).parents[3] / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP"
RANGES = NCAP / "CA-FC_2026" / "Variations" / "StandardRange"
NO_PARAMETERS = ParameterSpace([Parameter("fixed", 0, 0, choices=("x",))])
SIZE = 120


@dataclass(frozen=True, eq=False)
class Told:
    """Scenarios, the facts for naming them, and what an observer sees."""

    account: NamingFacts
    scenes: list[Scene]

    @classmethod
    def of(cls, recordings, ego, other, space=NO_PARAMETERS, values=None):
        values = values or [{"fixed": "x"} for _ in recordings]
        outcomes = [find_outcome(one, ego, other) for one in recordings]
        traits = [measure_features(one, end) for one, end in zip(recordings, outcomes, strict=True)]
        read = [{one.name: one.extract_value(each) for one in space.parameters} for each in values]
        scenes = [Scene(one, ego, other, each) for one, each in zip(recordings, read, strict=True)]
        return cls(NamingFacts.from_scenarios(outcomes, traits, space, values), scenes)

    @cached_property
    def columns(self):
        """Columns by which scenarios are clustered here: features and parameters."""
        traits = np.nan_to_num(np.array(list(self.account.features.values())).T, nan=-1.0)
        spread = np.where(traits.std(axis=0) > 0, traits.std(axis=0), 1.0)
        return (traits - traits.mean(axis=0)) / spread


def names_of(told, labels):
    labels = np.asarray(labels)
    examples = [int(np.flatnonzero(labels == kind)[0]) for kind in range(labels.max() + 1)]
    return {kind: one.text for kind, one in name_clusters(told.account, labels, examples).items()}


def require_true(told, labels):
    """Each name is true of 95 % of its scenarios, and no two are the same."""
    labels = np.asarray(labels)
    names = names_of(told, labels)
    assert len(set(names.values())) == len(names) == labels.max() + 1
    for kind, name in names.items():
        scenes = [told.scenes[k] for k in np.flatnonzero(labels == kind)]
        assert np.mean([is_true(name, one) for one in scenes]) >= 0.95, name


def simulated(logical, other, on_collision="stop", drivers=None):
    points = logical.space.snap(
        qmc.Sobol(len(logical.space.parameters), rng=np.random.default_rng(1)).random(128)[:SIZE]
    )
    values = logical.space.values(points)
    simulator = Builtin(on_collision=on_collision, drivers=drivers or {})
    return Told.of(
        ran(simulator, [logical.concrete_scenario(one) for one in values]), "Ego", other, logical.space, values
    )


STUDIED = ["x_intersection", "t_intersection", "CPNCO", "CBFA", "CCCscp", "CBNA", "CPNA"]


@pytest.fixture(scope="module", params=at_night(STUDIED, STUDIED[1:]))
def told(request):
    name = request.param
    if name == "x_intersection":
        return simulated(request.getfixturevalue(name), "Pedestrian", "continue")
    if name == "t_intersection":
        return simulated(request.getfixturevalue(name), "C")
    if not RANGES.exists():
        pytest.skip("Euro NCAP's files are not beside the checkout")
    ranges = {"Ego_speed_kph": "10:60"}
    if name == "CCCscp":
        ranges["Target_final_speed_kph"] = "20:60"
    logical = LogicalScenario.read(None, RANGES / f"{name}.xosc", [f"{key}={one}" for key, one in ranges.items()])
    return simulated(logical, "Target" if name == "CCCscp" else "VRU", drivers={"Ego": driver_by_name("normal")})


@pytest.mark.parametrize(
    ("numbers", "columns"),
    [((1, 5), ("nearest",)), pytest.param((2, 3, 8), ("lowest speed", "duration"), marks=pytest.mark.slow)],
)
def test_names_are_true_whatever_is_clustered_and_however_many_kinds_there_are(told, numbers, columns):
    tree = linkage(told.columns, "ward")
    for kinds in numbers:
        require_true(told, fcluster(tree, kinds, "maxclust") - 1)
    # By a single column, as by an aspect; with noise; and by nothing.
    for name in columns:
        column = np.nan_to_num(told.account.features[name], nan=-1.0)[:, None]
        require_true(told, fcluster(linkage(pdist(column), "average"), 4, "maxclust") - 1)
    drawn = np.random.default_rng(0)
    require_true(told, np.where(drawn.random(SIZE) < 0.2, -1, fcluster(tree, 3, "maxclust") - 1))
    require_true(told, drawn.integers(0, 4, SIZE))


def passing(start, speed):
    return entity(start, 0.0, 0.0, (0, speed))


def stopping(until):
    return entity(0.0, 0.0, 0.0, (0, 15), (2, 15), (4.2, 0), (until, 0), (until + 3, 12))


def crash(speed):
    return recording(Collision(2.0, ("Ego", "P")), Ego=passing(50.0 - 2.0 * speed, speed), P=CROSSES, until=2.0)


KINDS = {
    "before": [recording(Ego=passing(0.0, 18.0 + 0.1 * k), P=CROSSES) for k in range(10)],
    "stops": [recording(Ego=stopping(5.0 + 0.1 * k), P=CROSSES) for k in range(10)],
    "after": [recording(Ego=passing(-10.0 - k, 10.0), P=CROSSES) for k in range(10)],
    "low": [crash(3.0 + 0.1 * k) for k in range(10)],
    "high": [crash(14.0 + 0.1 * k) for k in range(10)],
    "apart": [recording(Ego=passing(0.0, 10.0 + k), P=entity(50, 60 + k, NORTH, (0, 1.5))) for k in range(10)],
}


def hand_made(*kinds):
    told = Told.of([one for kind in kinds for one in KINDS[kind]], "Ego", "P")
    return told, np.repeat(range(len(kinds)), 10)


def test_kinds_that_a_person_would_tell_apart_have_the_names_that_he_would_give():
    told, labels = hand_made("before", "stops", "after", "low", "high", "apart")
    require_true(told, labels)
    assert list(names_of(told, labels).values()) == [
        "Ego passes before P, closely",
        "Ego stops for P",
        "Ego passes after P, without a stop",
        "Ego collides with P, at low speed",
        "Ego collides with P, at high speed",
        "Ego does not meet P",
    ]


def test_one_of_twenty_may_end_otherwise():
    told, labels = hand_made("before", "after", "stops", "low")
    told = Told.of([one.recording for one in told.scenes[:31]], "Ego", "P")
    labels = np.minimum(labels, 1)[:31]
    require_true(told, labels)
    assert names_of(told, labels)[1] == "Ego passes after P"


def test_a_kind_with_several_endings_is_named_by_them():
    told, labels = hand_made("before", "stops", "low")
    require_true(told, np.minimum(labels, 1))
    assert names_of(told, np.minimum(labels, 1))[1] == "Ego collides with P or stops for P"


def test_kinds_with_one_ending_are_set_apart_by_what_differs():
    fast = [recording(Ego=passing(0.0, 30.0 + 0.1 * k), P=CROSSES) for k in range(10)]
    later = [recording(Ego=passing(-300.0 - k, 30.0), P=walker(exists=(0.0, 19.0), y=-24.0)) for k in range(10)]
    told = Told.of([*KINDS["before"], *fast, *later], "Ego", "P")
    labels = np.repeat([0, 1, 2], 10)
    require_true(told, labels)
    assert list(names_of(told, labels).values()) == [
        "Ego passes before P, closely, enters after 2 s",
        "Ego passes before P, closely, enters before 2 s",
        "Ego passes before P, clear",
    ]


def test_kinds_may_be_set_apart_by_the_side_that_the_other_comes_from():
    def walking(side, k):
        return entity(50.0, side * 6.0, -side * NORTH, (0, 1.5 + 0.01 * k), length=0.6, width=0.6)

    told = Told.of(
        [recording(Ego=passing(0.0, 18.0), P=walking(side, k)) for side in (1, -1) for k in range(10)], "Ego", "P"
    )
    labels = np.repeat([0, 1], 10)
    require_true(told, labels)
    begin = "Ego passes before P, closely, P from the"
    assert list(names_of(told, labels).values()) == [f"{begin} left", f"{begin} right"]


def test_a_second_bound_on_the_same_side_takes_the_place_of_the_first():
    values = np.arange(10.0)
    above = [Predicate(f"above {bound}", values > bound, "above") for bound in (2, 4)]
    name = ClusterName(Predicate("Ego goes", values >= 0.0))
    for clause in (above[0], Predicate("below 8", values < 8, "below"), Predicate("clear", values != 5), above[1]):
        name = name.with_qualifier(clause)
    assert name.text == "Ego goes, below 8, clear, above 4"
    assert np.flatnonzero(name.holds).tolist() == [6, 7]


def test_of_values_that_go_together_the_first_that_tells_is_named():
    choices = ("1, left.xosc", "-1, right.xosc")
    space = ParameterSpace([Parameter("side, file", 0, 1, choices=choices)])
    same = [KINDS["before"][0]] * 20
    told = Told.of(same, "Ego", "P", space, [{"side, file": choices[k // 10]} for k in range(20)])
    labels = np.repeat([0, 1], 10)
    require_true(told, labels)
    begin = "Ego passes before P, closely, side is"
    assert list(names_of(told, labels).values()) == [f"{begin} 1", f"{begin} -1"]


@pytest.mark.parametrize(
    ("low", "high", "ends"),
    [
        (1500, 1800, ["mass < 1600 kg", "mass > 1600 kg"]),
        (26_000, 31_000, ["mass < 30000 kg", "mass > 30000 kg"]),
    ],
)
def test_bounds_from_a_thousand_on_are_written_without_an_exponent(low, high, ends):
    space = ParameterSpace([Parameter("mass", 0, 50_000, unit="kg")])
    masses = np.r_[low - np.arange(10.0), high + np.arange(10.0)]
    told = Told.of([KINDS["before"][0]] * 20, "Ego", "P", space, [{"mass": mass} for mass in masses.tolist()])
    labels = np.repeat([0, 1], 10)
    require_true(told, labels)
    assert [name.rpartition(", ")[2] for name in names_of(told, labels).values()] == ends


def test_lane_changes_to_the_left_and_to_the_right_are_set_apart():
    def changing(to, k):
        aside = to * np.clip((np.arange(0.0, 20.05, 0.1) - 3.0 - 0.1 * k) / 3.0, 0.0, 1.0)
        ego = passing(0.0, 10.0) | {"y": aside, "heading": np.arctan2(np.gradient(aside, 0.1), 10.0)}
        return recording(Ego=ego, P=entity(30.0, 0.0, 0.0, (0, 10)))

    told = Told.of([changing(to, k) for to in (3.5, 0.0, -3.5) for k in range(10)], "Ego", "P")
    labels = np.repeat([0, 1, 2], 10)
    require_true(told, labels)
    ends = [name.removeprefix("Ego stays behind P, ") for name in names_of(told, labels).values()]
    assert ends == ["moves to the left", "goes straight on", "moves to the right"]


def test_what_nothing_sets_apart_is_named_after_an_example():
    told = Told.of([KINDS["before"][0]] * 20, "Ego", "P")
    names = names_of(told, np.repeat([0, 1], 10))
    assert list(names.values()) == [f"Ego passes before P, closely, as in scenario {k}" for k in (0, 10)]


NEVER = {"exists": (-2.0, -1.0)}


def test_kinds_in_which_one_is_never_there_say_so():
    nobody = [recording(Ego=entity(0.0, 0.0, 0.0, (0, 10.0), **NEVER), P=walker(y=-6.0 - k)) for k in range(10)]
    alone = [recording(Ego=passing(-k, 10.0), P=walker(**NEVER)) for k in range(10)]
    stands = [recording(Ego=passing(-k, 0.0), P=CROSSES) for k in range(10)]
    told = Told.of([*nobody, *alone, *stands, *KINDS["apart"]], "Ego", "P")
    labels = np.repeat(range(4), 10)
    require_true(told, labels)
    assert list(names_of(told, labels).values()) == [
        "Ego is never there",
        "Ego is there without P",
        "Ego stands all the time",
        "Ego does not meet P, stays more than 60 m from P",
    ]


NAMED = [
    ("Ego", "C, closely"),
    ("the ego", 'P" or "Q'),
    ("Ego", "P or stops for Q"),
    ("E, clear", "Q and R collide"),
    ("Ego\n", "a\tb"),
    ("Ich", "Fußgänger"),
    ("自车", "行人, 近"),
    ("Ego", "{}"),
    ("Ego", "P and Q first"),
    ("Ego", "x waits"),
]


@pytest.mark.parametrize("named", at_night(NAMED, [one for one in NAMED if one not in NAMED[:6:2]]))
def test_no_name_of_an_entity_is_read_as_something_else(named):
    ego, other = named
    kinds = ("before", "stops", "after", "low", "apart")
    further = {"Ego": ego, "P": other}
    recordings = [
        replace(one, names=tuple(further[name] for name in one.names)) for kind in kinds for one in KINDS[kind]
    ]
    recordings = [
        replace(one, collisions=tuple(replace(hit, entities=(ego, other)) for hit in one.collisions))
        for one in recordings
    ]
    told = Told.of(recordings, ego, other)
    labels = np.repeat(range(len(kinds)), 10)
    require_true(told, labels)
    for kind, name in names_of(told, labels).items():
        assert written(other) in name, name
        assert name.startswith(f"{written(ego)} "), name
        # The rest is the same as with plain names.
        plain = names_of(hand_made(*kinds)[0], labels)[kind]
        assert name.replace(written(other), "P").replace(written(ego), "Ego", 1) == plain
    for one in told.account.outcomes:
        assert one.text.replace(written(ego), "Ego").replace(written(other), "P") in {
            "Ego first", "P first", "Ego and P collide", "ways do not cross",
        }  # fmt: skip


def test_further_entities_and_parameters_with_odd_names_are_quoted():
    space = ParameterSpace([Parameter("side, file", 0, 1, choices=("a or b", "c"), unit=""), Parameter("v, w", 0, 1)])
    odd = walker(y=-20.0)
    told = Told.of(
        [recording(**{"Ego": passing(0.0, 18.0), "P": CROSSES, "Q, clear": odd})] * 20,
        "Ego", "P", space, [{"side, file": ("a or b", "c")[k // 10], "v, w": 0.5} for k in range(20)],
    )  # fmt: skip
    labels = np.repeat([0, 1], 10)
    require_true(told, labels)
    assert names_of(told, labels)[0].endswith('"side, file" is "a or b"')
    assert 'before "Q, clear"' in {one.text for one in predicates_with_fixed_bounds(told.account)}


@pytest.mark.slow
def test_clusterings_are_compared_with_what_happened(tmp_path):
    study = tmp_path / "s.db"
    folder = EXAMPLES / "t_intersection"
    logical = LogicalScenario.read(folder / "t_intersection.xosc", folder / "t_intersection.space.xosc")
    explore(
        logical, study, ego="Ego", other="C", metrics=["ttc"], budget=SIZE, seed=1, optimizer="sobol",
        on_collision="stop", critical=1.5,
    )  # fmt: skip
    found = analyze(study, ["ego-trajectory", "ttc"])
    with StudyFile.open(study, readonly=True) as opened:
        rows = opened.finished_rows()
        recordings = [opened.recording(row.id) for row in rows]
        facts = collect_facts(opened, [find_outcome(one, "Ego", "C") for one in recordings])
        scenes = [Scene(one, "Ego", "C", row.values) for one, row in zip(recordings, rows, strict=True)]
        critical = opened.scores("ttc") <= 1.5
    assert {"outcome", "first", "ego first", "collision", "stopped", "critical"} == set(facts)
    # In a collision nobody passes first.
    firsts = ["None" if one.recording.collisions else one.met[1] for one in scenes]
    assert facts["first"] == firsts
    assert facts["ego first"] == [str(one == "Ego") for one in firsts]
    np.testing.assert_array_equal(np.array(facts["critical"]) == "True", critical)
    np.testing.assert_array_equal(np.array(facts["stopped"]) == "True", [one.stops for one in scenes])
    hits = ["C" if one.recording.collisions else "None" for one in scenes]
    assert facts["collision"] == hits
    of_hits = mutual_information_with_facts(np.array([one == "C" for one in hits], dtype=int), facts)
    assert of_hits["collision"] == pytest.approx(1.0)
    shuffled = np.random.default_rng(0).permutation(np.arange(SIZE) % 3)
    assert all(abs(mutual) < 0.1 for mutual in mutual_information_with_facts(shuffled, facts).values())
    for one in found.values():
        assert one.fact_agreement == mutual_information_with_facts(one.labels, facts)
        names = [profile.name for profile in one.profiles if profile.cluster >= 0]
        assert len(set(names)) == len(names)
        for profile in one.profiles:
            members = [scenes[k] for k in np.flatnonzero(one.labels == profile.cluster)]
            if profile.cluster >= 0:
                assert np.mean([is_true(profile.name, each) for each in members]) >= 0.95
                assert profile.true_of >= 0.95
                assert profile.example in [row.id for row, label in zip(rows, one.labels, strict=True) if label == profile.cluster]  # fmt: skip
