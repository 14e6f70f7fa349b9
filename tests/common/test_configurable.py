"""Optimizers, simulators, drivers and metrics are objects whose `repr` evaluates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.drivers import *  # noqa: F403 - for `eval`
from cornercase.metrics import *  # noqa: F403
from cornercase.optimizers import *  # noqa: F403
from cornercase.scenario import ParameterSpace
from cornercase.simulators import *  # noqa: F403
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X

REGISTRIES: dict[str, Any] = {
    "driver": cc.drivers.DRIVERS,
    "metric": cc.metrics.METRICS,
    "optimizer": cc.optimizers.OPTIMIZERS,
    "simulator": cc.simulators.SIMULATORS,
}
OWN_OPTIONS = (
    "bayes:filling=0.1", "level-set:candidates=100,filling=0.5", "evolutionary:population=12", "optuna:sampler=nsga2",
    "esmini:seed=3", "sumo:seed=7", "carla:port=3000,undriven=true", "ttc:accelerating=true",
    "trajectory-distance:ahead=20", "stl:always(clearance > 0.5)", "normal:horizon=4.5", "simple:reaction_time=1",
    "fsm:delay=0.5",
)  # fmt: skip
NAMES = [
    (kind, name)
    for kind, registry in REGISTRIES.items()
    for name in (*registry.names(), *(text for text in OWN_OPTIONS if text.partition(":")[0] in registry))
    if name in OWN_OPTIONS or (registry.get_factory(name).__module__.startswith("cornercase.") and name != "carmaker")
    # Those of a file or a program are nothing without it.
    if not (kind == "driver" and (name.startswith("rss:") or name in ("exec", "fmu")))
]


@pytest.mark.parametrize(("kind", "text"), [(kind, name) for kind, name in NAMES])
def test_repr_evaluates_and_str_is_the_text_of_the_command_line(kind, text):
    configured = REGISTRIES[kind].create(text)
    again = eval(repr(configured))
    assert again == configured
    assert hash(again) == hash(configured)
    assert REGISTRIES[kind].create(str(again)) == configured
    assert str(again) == text


def test_objects_with_other_options_differ_and_defaults_are_left_out():
    assert repr(cc.optimizers.LevelSet(filling=0.2)) == "LevelSet()"
    assert cc.optimizers.LevelSet(20_000) == cc.optimizers.LevelSet() != cc.optimizers.LevelSet(filling=0.1)
    assert cc.optimizers.Sobol() != cc.optimizers.Random()
    simulator = cc.simulators.Builtin(time_step=0.1, drivers={"Ego": "cautious"})
    assert repr(simulator) == "Builtin(time_step=0.1, drivers={'Ego': 'cautious'})"
    assert str(simulator) == "builtin"
    assert simulator != cc.simulators.Builtin(time_step=0.1)


def test_an_optimizer_of_options_stays_as_it_is_when_it_starts():
    space, search = ParameterSpace.from_ranges(["a=0:1", "b=0:1"]), cc.optimizers.LevelSet(filling=0.4)
    first = search.start(space, 1, threshold=0.5)
    points = first.ask(20)
    first.tell(points, points[:, 0])
    np.testing.assert_array_equal(search.start(space, 1, threshold=0.5).ask(20), points)
    assert search == first == cc.optimizers.OPTIMIZERS.create("level-set:filling=0.4")


def test_a_changed_option_changes_the_name():
    bayes = cc.optimizers.Bayes(filling=0.1)
    assert str(bayes.with_options(filling=0.5)) == "bayes:filling=0.5"
    assert cc.metrics.METRICS.create("ttc:accelerating=true").with_options(accelerating=False).name == "ttc"
    simulator = cc.simulators.SIMULATORS.create("esmini:seed=3,time_step=0.1")
    assert str(simulator.with_options(seed=4)) == "esmini:seed=4"
    # Without a change the text stays as it was given, as do names of the user.
    assert str(simulator.with_options()) == str(simulator)
    bayes.name = "mine"
    assert str(bayes.with_options(filling=0.5)) == "mine"


@dataclass
class Halves(cc.Optimizer):
    """Points of the lower part of a space; nobody has registered it."""

    part: float = 0.5

    def prepare(self, space, seed):
        self._points = self.part * np.random.default_rng(seed).random((50, space.dimension))

    def ask(self, n):
        return self._points[:n]

    def tell(self, points, scores):
        self._points = self._points[len(points) :]


class Slower(cc.simulators.Builtin):
    """The builtin simulator for some seconds only; nobody has registered it."""

    name, in_process = "slower", False

    def __init__(self, limit: float = 5.0, **options):
        super().__init__(**{**options, "duration": limit})


def explored(path, **options):
    about: dict[str, Any] = {
        "space": SPACE,
        "ego": "Ego",
        "other": "Pedestrian",
        "metrics": ["wttc"],
        "budget": 4,
        "batch": 2,
    }
    cc.explore(X, path, **about | options)
    with StudyFile.open(path, readonly=True) as study:
        return study.meta, [list(row.point) for row in study.rows()], study.scores("wttc").tolist()


def test_objects_and_texts_explore_the_same(tmp_path):
    texts = explored(tmp_path / "t.db", optimizer="bayes:filling=0.1", time_step=0.1, drivers={"Ego": "cautious"})
    objects = explored(
        tmp_path / "o.db",
        optimizer=cc.optimizers.Bayes(filling=0.1),
        simulator=cc.simulators.Builtin(time_step=0.1, drivers={"Ego": "cautious"}),
        stop_when=[cc.stop.seconds(600), cc.stop.no_improvement(100)],
        workers=2,
        timeout=120.0,
    )
    assert objects == texts


def test_classes_that_nobody_has_registered_run_in_processes_of_their_own(tmp_path):
    meta, points, _ = explored(tmp_path / "s.db", optimizer=Halves(0.25), simulator=Slower(limit=4.0), workers=2)
    assert (np.array(points) <= 0.25).all()
    assert meta.settings["duration"] == 4.0
    assert meta.simulator == "slower:limit=4.0"
    assert meta.optimizer == f"{__name__}:Halves:part=0.25"


def test_a_time_step_that_is_given_twice_is_refused(tmp_path):
    with pytest.raises(InputError, match="`time_step`"):
        explored(tmp_path / "s.db", simulator=cc.simulators.Builtin(time_step=0.1), time_step=0.02)
