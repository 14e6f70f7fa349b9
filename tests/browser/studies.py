"""Small studies to look at: hostile names, four parameters, a Pareto front, scenarios that failed, one scenario."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

import cornercase as cc
from conftest import EXAMPLES
from cornercase.study import StudyFile
from helpers.joint_values import joint_values
from helpers.synthetic_study import SPACE, about, explorer

# What would be run, end a script or break an attribute if a page took a name for HTML; a slash can be in no file's name.
HOSTILE = """<script>document.title='run'<script><img src=x onerror="document.title='run'">"""
ENTITY = HOSTILE + """</script> "Fußgänger" & 'пешеход' 歩行者"""
X = EXAMPLES / "x_intersection"
METRICS = ("wttc", "trajectory-distance")


def make_hostile(folder: Path) -> Path:
    """The X-intersection, analysed and reduced, with names that a page must not take for HTML."""
    shutil.copytree(X, folder / "files")
    scenario = folder / "files" / f"{HOSTILE} 交差点.xosc"
    text = (X / "x_intersection.xosc").read_text(encoding="utf-8")
    scenario.write_text(text.replace('"Pedestrian"', quoteattr(ENTITY)), encoding="utf-8")
    ranges = ["ego_start=20:80:0.1", "pedestrian_wait=2:10:0.01", "p1_speed=6:12:0.1"]
    path = folder / f"{HOSTILE} 交差点.db"
    cc.explore(
        scenario, path, ego="Ego", other=ENTITY, metrics=METRICS, ranges=ranges, optimizer="sobol", budget=60, seed=1
    )
    cc.analyze(path)
    cc.reduce(path, folder / "reduced", size=8, scenario=scenario)
    return path


def make_plain(folder: Path) -> Path:
    """The X-intersection, analysed and reduced."""
    path = folder / "study.db"
    logical = cc.LogicalScenario.read(X / "x_intersection.xosc", X / "x_intersection.space.xosc")
    cc.explore(
        logical, path, ego="Ego", other="Pedestrian", metrics=METRICS, optimizer="level-set", budget=60, audit=0.2
    )
    cc.analyze(path)
    cc.reduce(path, folder / "reduced", size=8)
    return path


def make_together(folder: Path) -> Path:
    """Values that are set together, and an option of the driver; analysed and reduced."""
    path = folder / "study.db"
    cc.explore(
        joint_values(folder), path, ego="Ego", other="Pedestrian", metrics=METRICS, optimizer="sobol", budget=26,
        drivers={"Ego": "normal"},
    )  # fmt: skip
    cc.analyze(path)
    cc.reduce(path, folder / "reduced", size=4)
    return path


def make_four(folder: Path) -> Path:
    """Four parameters, analysed."""
    path = folder / "study.db"
    ranges = ["ego_start=30:80", "pedestrian_wait=0:6", "p1_speed=4:10", "ego_speed=7:13"]
    cc.explore(
        X / "x_intersection.xosc",
        path,
        ego="Ego",
        other="Pedestrian",
        metrics=["wttc"],
        ranges=ranges,
        optimizer="sobol",
        budget=48,
    )
    cc.analyze(path)
    return path


def make_pareto(folder: Path) -> Path:
    """A Pareto front of two metrics, of scenarios whose file is not there, with a driver of one's own; some failed."""
    path = folder / "study.db"
    meta = replace(about(SPACE, "distance", "wttc"), pareto=True, settings={"drivers": {"Ego": {"class": "Own"}}})
    with StudyFile.create(path, meta) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    return path


def make_failed(folder: Path) -> Path:
    """Scenarios of which some failed, with a threshold, in clusters."""
    path = folder / "study.db"
    with StudyFile.create(path, replace(about(SPACE, "distance", "wttc"), critical=1.0)) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
    cc.analyze(path, "distance", gamma=4.0, eps=0.2, min_samples=3)
    return path


def make_one(folder: Path) -> Path:
    """One scenario."""
    path = folder / "study.db"
    cc.explore(
        X / "x_intersection.xosc",
        path,
        ego="Ego",
        other="Pedestrian",
        metrics=["wttc"],
        ranges=["ego_start=40:41"],
        budget=1,
    )
    return path


MAKERS: dict[str, Callable[[Path], Path]] = {
    "hostile": make_hostile,
    "plain": make_plain,
    "together": make_together,
    "four": make_four,
    "pareto": make_pareto,
    "failed": make_failed,
    "one": make_one,
}


def made(folder: Path, name: str) -> Path:
    """A study of a name, made in a folder of its own."""
    (folder / name).mkdir(parents=True)
    with warnings.catch_warnings():
        # Of small samples, and of elements without effect: nothing that these tests are about.
        warnings.simplefilter("ignore")
        return MAKERS[name](folder / name)
