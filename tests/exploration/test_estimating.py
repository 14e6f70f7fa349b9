from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom
from typer.testing import CliRunner

from conftest import at_night
from cornercase import NoticeWarning, estimate, explore
from cornercase._common.errors import InputError
from cornercase.cli import app
from cornercase.evidence._probability import probability_from_counts
from cornercase.evidence._rare_events import ImportanceSampling
from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._estimation import describe_doubts
from cornercase.exploration._explorer import ScenarioExplorer
from cornercase.exploration._probability_estimator import ProbabilityEstimator
from cornercase.optimizers import OPTIMIZERS
from cornercase.recordings import Collision, Recording
from cornercase.report._report_data import read_report_data
from cornercase.report.html._probability_section import render_probability
from cornercase.report.text._answers import page_answers
from cornercase.scenario import Constraint, LogicalScenario, ParameterDeclaration, ParameterSpace
from cornercase.study import StudyFile
from helpers.fake_simulators import NoisySimulator
from helpers.synthetic_study import LOGICAL, Synthetic, about

# Scenarios with a > 0.9 fail, and the others are 10 |a - b| m apart; a goes by steps of 0.01.
STEPS = np.arange(91) / 100.0
CRITICAL = 0.05


def share_within(reach):
    """Probability that |a - b| is at most `reach` and a at most 0.9."""
    return (np.minimum(STEPS + reach, 1.0) - np.maximum(STEPS - reach, 0.0)).sum() / 101


def opened(path, space=LOGICAL.space):
    return (
        StudyFile.open(path, readonly=False)
        if path.exists()
        else StudyFile.create(path, about(space, "distance", budget=800))
    )


def estimator(study, simulator=None, budget=800, logical=LOGICAL, learn=320, gap=1.0):
    configuration = ExplorationConfig(
        logical,
        ego="Ego",
        other="B",
        metrics=("distance",),
        optimizer="random",
        critical=CRITICAL,
        budget=budget,
        seed=3,
    )
    sampling = ImportanceSampling(logical.space, 2, learn, 3)
    return ProbabilityEstimator(configuration, simulator or Synthetic(), sampling, study, gap)


def report_data(path):
    with StudyFile.open(path) as study:
        return read_report_data(study)


def contents(path):
    with StudyFile.open(path, readonly=True) as study:
        arrays, info = study.read_analysis("estimate")
        return (
            [(row.round, row.point.tobytes(), row.state) for row in study.rows()],
            arrays["weights"].tobytes(),
            info,
        )


def test_the_probability_is_the_true_one_and_failures_are_told(tmp_path):
    with opened(tmp_path / "e.db") as study:
        found = estimator(study).run()
    truth = share_within(CRITICAL / 10.0)
    assert found.critical.low <= truth <= found.critical.high
    assert found.critical.error < 0.4
    assert found.scenarios == 800
    assert found.critical.scenarios == 800 - found.n_learning
    assert any("failed" in warning for warning in found.warnings)
    # Boxes of hardly any length have a gap of at most 1 m where the centres are at most 1 m apart.
    assert found.encounter.low <= share_within(0.1) <= found.encounter.high
    assert found.critical_given_encounter.low <= truth / share_within(0.1) <= found.critical_given_encounter.high
    assert found.collision.met == 0
    none = f"None of the {found.critical.scenarios + 64} scenarios that count has a collision. The 64 scenarios drawn"
    assert any(warning.startswith(none) for warning in found.warnings)
    (answer,) = (one for one in page_answers(report_data(tmp_path / "e.db")) if one.name == "probability")
    assert f"It collides with a probability of at most {found.collision.high:.3g} (95 %)." in answer.text
    assert found.criterion == "distance <= 0.05 m"
    # Which draws each probability comes from.
    table = found.table()
    assert table.loc["encounter", ["scenarios", "method"]].tolist() == [64, "plain Monte Carlo, Clopper-Pearson"]
    assert table.loc["critical", ["scenarios", "met"]].tolist() == [found.critical.scenarios, found.critical.met]
    assert table.loc["critical given an encounter", "method"].startswith("quotient")
    uniform = "All 2 parameters are uniform: probabilities are shares of the space, no frequency in traffic."
    assert found.warnings[0] == uniform


class Touching(Synthetic):
    """Ego and B collide if they are less than 1 m apart."""

    def run(self, concretes):
        for one in super().run(concretes):
            near = isinstance(one, Recording) and one.x[1, 0] < 1.0
            yield replace(one, collisions=(Collision(1.0, ("Ego", "B")),)) if near else one


class Elsewhere(Synthetic):
    """Ego and B collide if they are 6 to 6.3 m apart."""

    def run(self, concretes):
        for one in super().run(concretes):
            collides = isinstance(one, Recording) and 6.0 < abs(one.x[1, 0] - one.x[0, 0]) < 6.3
            yield replace(one, collisions=(Collision(1.0, ("Ego", "B")),)) if collides else one


def test_if_scores_mislead_plain_draws_count_and_it_is_said(tmp_path, monkeypatch):
    # When they do is tested with the sampling.
    monkeypatch.setattr(ImportanceSampling, "_scores_mislead", lambda sampling, *_: sampling._rounds >= 4)

    def run(budget, simulator):
        with opened(tmp_path / "e.db") as study:
            configuration = ExplorationConfig(
                LOGICAL, ego="Ego", other="B", metrics=("distance",), optimizer="random", critical=-1.0, budget=budget,
                seed=3,
            )  # fmt: skip
            sampling = ImportanceSampling(LOGICAL.space, 2, 320, 3)
            return ProbabilityEstimator(configuration, simulator, sampling, study, 1.0).run(), study.read_analysis(
                "estimate"
            )[0]["weights"]

    found, weights = run(800, Elsewhere())
    assert found.critical.met == 0
    assert found.n_learning < 320
    assert weights.tolist() == [1.0] * (800 - found.n_learning)
    drawn = found.collision.scenarios
    assert found.collision == probability_from_counts(found.collision.met, drawn)
    assert drawn == 800 - found.n_learning
    assert found.collision.low <= share_within(0.63) - share_within(0.6) <= found.collision.high
    assert any(warning.startswith("What was learned met critical scenarios and") for warning in found.warnings)
    assert any(f"The {drawn} scenarios drawn from the distributions" in warning for warning in found.warnings)
    (section,) = render_probability(report_data(tmp_path / "e.db"))
    learned = f"{found.n_learning} of the 800 scenarios were run only to learn where to draw. So the share of the"
    assert learned in section.html
    assert run(1200, Elsewhere())[0].collision.scenarios == drawn + 400


@pytest.mark.parametrize(
    ("event", "uncounted", "said"),
    [
        ("collision", 0, "None of the 480 scenarios that count has a collision. The 40 scenarios"),
        ("collision", 1, "count has a collision; one that was run only to learn where to draw has one. The 40"),
        ("collision", 12, "count has a collision; 12 that were run only to learn where to draw have one. The 40"),
        ("critical scenario", 12, "count is critical; 12 that were run only to learn where to draw are critical. The"),
    ],
)
def test_an_estimate_without_the_event_says_where_it_was_met(event, uncounted, said):
    nothing = probability_from_counts(0, 40)
    (sentence,) = describe_doubts(event, nothing, nothing, 480, uncounted)
    assert said in sentence
    assert sentence.endswith(f"bound the probability of a {event} by {nothing.high:.3g} (95 %).")


def test_a_collision_is_critical_also_by_a_metric_that_is_not_defined_in_one(tmp_path):
    metrics = ("pet",)
    configuration = ExplorationConfig(
        LOGICAL, ego="Ego", other=["B"], metrics=metrics, optimizer="random", critical=1.0, budget=300, seed=3
    )
    meta = about(LOGICAL.space, *metrics, budget=300)
    with StudyFile.create(tmp_path / "e.db", meta) as study:
        sampling = ImportanceSampling(LOGICAL.space, 2, 120, 3)
        found = ProbabilityEstimator(configuration, Touching(), sampling, study, 1.0).run()
        # Where scores take two values, all scenarios are plain draws, and count.
        assert sum(study.scores("pet") <= 1.0) == found.critical.met
    assert any("plain Monte Carlo" in warning for warning in found.warnings)
    assert found.n_learning == 0
    assert found.critical.met == found.collision.met > 10
    assert found.critical.value == found.collision.value


def test_interrupted_it_goes_on_as_if_undisturbed(tmp_path):
    with opened(tmp_path / "whole.db") as study:
        whole = estimator(study, budget=150, learn=60).run()
    interruptions = 0
    for after in (5, 40, 60, 10_000):
        with opened(tmp_path / "parts.db") as study:
            found = estimator(study, Synthetic(interrupts=after), budget=150, learn=60).run()
            interruptions += found.interrupted
    assert interruptions == 3
    assert found.to_json() == whole.to_json()
    assert contents(tmp_path / "parts.db") == contents(tmp_path / "whole.db")


def test_a_larger_budget_adds_to_what_is_there(tmp_path):
    with opened(tmp_path / "e.db") as study:
        first = estimator(study, budget=120, learn=50).run()
        second = estimator(study, budget=300, learn=50).run()
    assert (first.scenarios, second.scenarios) == (120, 300)
    assert second.n_learning == first.n_learning
    assert second.critical.error < first.critical.error


def test_scenarios_of_another_sampling_are_refused_as_their_weights_would_be_wrong(tmp_path):
    with opened(tmp_path / "e.db") as study:
        estimator(study, budget=300, learn=200).run()
        done = len(study.rows())
    with opened(tmp_path / "e.db") as study:
        with pytest.raises(InputError, match=r"e\.db: its round 10 was drawn by another version of cornercase or"):
            estimator(study).run()
        assert len(study.rows()) == done


def test_of_a_small_space_all_is_run_and_nothing_is_unsure(tmp_path):
    space = ParameterSpace.from_ranges(["a=0:1:0.1", "b=0:1:0.1"])
    logical = replace(LOGICAL, space=space)
    with opened(tmp_path / "e.db", space) as study:
        found = estimator(study, logical=logical).run()
    assert found.scenarios == 121
    # Ten of the eleven values of a run, each with the same value of b.
    assert found.critical.value == pytest.approx(10 / 121)
    assert (found.critical.low, found.critical.high, found.critical.error) == (
        found.critical.value,
        found.critical.value,
        0.0,
    )


class Far(Synthetic):
    """B is `away` m further from the ego than in the scenario; NaN for nowhere."""

    def __init__(self, away):
        super().__init__()
        self.away = away

    def run(self, concretes):
        for one in super().run(concretes):
            yield replace(one, x=one.x + np.array([[0.0], [self.away]]))


@pytest.mark.parametrize(("away", "probability"), [(150.0, 0.0), (115.0, 7 / 9), (np.nan, 0.0)])
def test_a_gap_beyond_the_cap_of_clearance_counts_as_it_is(tmp_path, away, probability):
    logical = replace(LOGICAL, space=ParameterSpace.from_ranges(["a=0:0.8:0.4", "b=0:0.8:0.4"]))
    with opened(tmp_path / "e.db", logical.space) as study:
        found = estimator(study, Far(away), logical=logical, gap=120.0).run()
    # 115 m and 10 |a - b| m are more than 120 m in two of the nine scenarios.
    assert found.encounter.value == pytest.approx(probability)


def test_without_any_encounter_nothing_is_said_about_what_happens_in_one(tmp_path):
    logical = replace(LOGICAL, space=ParameterSpace.from_ranges(["a=0:0.2:0.1", "b=0:0.2:0.1"]))
    with opened(tmp_path / "e.db", logical.space) as study:
        found = estimator(study, Far(20.0), logical=logical).run()
    assert (found.encounter.value, found.encounter.error) == (0.0, 0.0)
    assert (found.critical_given_encounter, found.collision_given_encounter) == (None, None)


SMALL = replace(LOGICAL, space=ParameterSpace.from_ranges(["a=0:1:0.05", "b=0:1:0.1"]))
# Of 21 x 11 scenarios, those with a <= 0.9 and the same b.
TRUTH = 10 / 231


def test_what_was_drawn_before_all_of_a_small_space_is_run_counts_once(tmp_path):
    with opened(tmp_path / "e.db", SMALL.space) as study:
        drawn = estimator(study, budget=150, learn=60, logical=SMALL).run()
        assert drawn.critical.error > 0.0
        found = estimator(study, budget=600, learn=60, logical=SMALL).run()
        arrays, _ = study.read_analysis("estimate")
        assert found.scenarios == len(study.rows()) > 231
        smaller = estimator(study, budget=150, learn=60, logical=SMALL).run()
    assert found.critical.value == pytest.approx(TRUTH)
    assert found.critical.error == 0.0
    assert len(set(arrays["ids"].tolist())) == len(arrays["ids"]) == 231
    assert smaller.critical == found.critical


@pytest.mark.parametrize("after", at_night([0, 380], {0}))
def test_while_not_all_of_a_small_space_was_run_there_are_bounds(tmp_path, after):
    logical = replace(LOGICAL, space=ParameterSpace.from_ranges(["a=0:1:0.05", "b=0:1:0.04"]))
    with opened(tmp_path / "e.db", logical.space) as study:
        some = estimator(study, Synthetic(interrupts=after), logical=logical).run()
        if after:
            with pytest.raises(InputError, match=r"runs all 546 scenarios.*set `budget` to 546 or more"):
                estimator(study, budget=530, logical=logical)
        every = estimator(study, logical=logical).run()
    assert some.interrupted
    assert some.critical.error is None
    assert some.critical.low < every.critical.value < some.critical.high
    assert "only" in some.critical.method
    assert every.critical.error == 0.0
    assert every.scenarios == 546


def test_a_small_space_is_that_which_its_constraints_leave(tmp_path):
    declarations = [
        ParameterDeclaration("a", "double", "0", ((Constraint("lessThan", "0.07"),),)),
        ParameterDeclaration("b", "double", "0", ()),
    ]
    space = ParameterSpace.from_ranges(["a=0:1:0.02", "b=0:1:0.02"]).with_constraints(declarations)
    with opened(tmp_path / "e.db", space) as study:
        found = estimator(study, budget=300, logical=replace(LOGICAL, space=space)).run()
    assert (found.scenarios, found.critical.error) == (4 * 51, 0.0)
    assert found.critical.value == pytest.approx(1 / 51)


@pytest.fixture(scope="module")
def explored(tmp_path_factory, x_intersection):
    folder = tmp_path_factory.mktemp("explored")
    logical = LogicalScenario.read(
        x_intersection.path, ranges=["ego_start=20:60", "pedestrian_wait=0:10", "p1_speed=1:10"]
    )
    file = folder / "study.db"
    explore(logical, file, ego="Ego", other="Pedestrian", metrics=["wttc"], critical=0.2, budget=20, optimizer="sobol")
    return file, x_intersection.path


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_workers_change_nothing(explored, tmp_path):
    file, scenario = explored
    one, two = (estimate(file, tmp_path / f"{n}.db", budget=120, scenario=scenario, workers=n) for n in (1, 2))
    assert one.to_json() == two.to_json()


@pytest.mark.filterwarnings("ignore::cornercase.NoticeWarning")
def test_a_study_is_estimated_with_its_own_simulator(explored, tmp_path):
    assert issubclass(NoticeWarning, Warning)
    file, scenario = explored
    found = estimate(file, tmp_path / "e.db", budget=100, scenario=scenario)
    assert found.scenarios == 100
    with StudyFile.open(tmp_path / "e.db", readonly=True) as study:
        assert len(study.finished_rows()) == 100
        assert study.meta.optimizer.startswith("importance-sampling:learn=40,known=20-")
        # The result can be computed from the content of the file.
        arrays, _ = study.read_analysis("estimate")
        scores = dict(zip((row.id for row in study.finished_rows()), study.scores("wttc"), strict=True))
        met = np.array([scores[number] <= 0.2 for number in arrays["ids"].tolist()])
        assert (arrays["weights"] * met).mean() == pytest.approx(found.critical.value)
        assert study.analyzed_aspects() == []
    # Asked again, by the command, it says the same.
    result = CliRunner().invoke(
        app,
        ["estimate", str(file), "-o", str(tmp_path / "e.db"), "--budget", "100", "--scenario", str(scenario), "--json"],
    )
    assert result.exit_code == 0
    told = json.loads(result.stdout)
    assert told["scenarios"] == 100
    assert told["critical"]["probability"] == found.critical.value
    assert told["critical"]["interval_95"] == found.to_json()["critical"]["95 % interval"]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"output": "study.db"}, "is the input file"),
        ({"budget": 99}, "`budget`"),
        ({"encounter": -1.0}, "`encounter`"),
        ({"drivers": {"Ego": "aggressive"}}, "was explored with another drivers"),
    ],
)
def test_what_cannot_be_estimated_is_refused(explored, tmp_path, given, words):
    file, scenario = explored
    output = file if "output" in given else tmp_path / "e.db"
    more = {name: value for name, value in given.items() if name != "output"}
    with pytest.raises(InputError, match=words):
        estimate(file, output, scenario=scenario, **more)
    assert file.exists()
    assert not (tmp_path / "e.db").exists()


def test_a_study_that_cannot_be_estimated_is_named_without_the_option_of_the_output(tmp_path):
    file = tmp_path / "front.db"
    StudyFile.create(file, about(LOGICAL.space, "distance", "wttc", pareto=True)).close()
    with pytest.raises(InputError) as refused:
        estimate(file, tmp_path / "e.db")
    # On the command line, `study` is the argument of -o.
    assert str(refused.value).startswith(f"{file}: was searched for a Pareto front")


def test_of_repeated_runs_is_told_how_many_are_critical_and_how_open_that_is(tmp_path):
    meta = about(LOGICAL.space, "distance", critical=30.0, repeats=6)
    with StudyFile.create(tmp_path / "s.db", meta) as study:
        configuration = ExplorationConfig(
            LOGICAL, ego="Ego", other="C", metrics=("distance",), optimizer="sobol", critical=30.0, budget=6, repeats=6
        )
        simulator = NoisySimulator()
        ScenarioExplorer(configuration, simulator, OPTIMIZERS.create("sobol").start(LOGICAL.space, 0), study).run()
        runs = study.critical_run_rates()
        table = study.table()
    assert runs is not None
    for k in range(6):
        given = [one for one in simulator.given[6 * k : 6 * k + 6] if one is not None]
        met = sum(one <= 30.0 for one in given)
        assert runs[k, 0] == met / len(given)
        # With a probability below `low`, so many would occur in one of twenty cases.
        if met:
            assert binom.sf(met - 1, len(given), runs[k, 1]) == pytest.approx(0.05)
        if met < len(given):
            assert binom.cdf(met, len(given), runs[k, 2]) == pytest.approx(0.05)
    assert table["critical runs"].tolist() == runs[:, 0].tolist()
    assert table["critical runs to"].tolist() == runs[:, 2].tolist()
