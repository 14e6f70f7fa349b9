"""Parts of another package are found by its entry points, and every command takes them."""

from __future__ import annotations

import site as python_site
import sys

import pytest

import cornercase as cc
from cornercase.clustering import read_analysis
from cornercase.study import StudyFile
from helpers.command_line import SPACE, X, process_of_all

PARTS = '''
import numpy as np

from cornercase.clustering import Aspect
from cornercase.drivers import Driver
from cornercase.metrics import Feature, FeatureGroup, Metric
from cornercase.optimizers import Optimizer
from cornercase.simulators import Builtin


class SpeedDifference(Metric):
    """Difference of the speeds of both."""

    name, unit, source = "speed-difference", "m/s", "an example"
    lower_is_critical, cap = False, 0.0

    def course(self, recording, ego, other):
        return np.abs(recording.speed[recording.entity_index(ego)] - recording.speed[recording.entity_index(other)])


class Pace(Aspect):
    """The ego's acceleration."""

    name, unit = "pace", "m/s^2"

    def series(self, recording, ego, other):
        return recording.acceleration[recording.entity_index(ego)][:, None]


class Vigour(FeatureGroup):
    """The ego's highest acceleration."""

    name, features = "vigour", (Feature("highest-acceleration", "m/s²"),)

    def values(self, encounter):
        return np.array([np.nanmax(encounter.recording.acceleration[encounter.ego_row], initial=0.0)])


class Diagonal(Optimizer):
    """Goes along the diagonal of the space, as long as it is told how vigorous the ego is."""

    name, requires = "diagonal", frozenset({"budget", "features"})

    def __init__(self, begin=0.0):
        self.begin = begin

    def prepare(self, space, seed, budget, features):
        self.points = np.linspace(self.begin, 1.0, budget)[:, None] * np.ones(space.dimension)
        self.column = [one.name for one in features].index("highest-acceleration")

    def ask(self, n):
        return self.points[:n]

    def tell(self, points, scores, features):
        assert (features[:, self.column] >= 0.0).all()
        self.points = self.points[len(points) :]


class Steady(Driver):
    """Keeps the speed that is asked for and sees nobody."""

    def acceleration(self, situation):
        return np.clip(situation.target_speed - situation.speed, -3.0, 2.0)


class Short(Builtin):
    """The builtin simulator, for 5 s at most."""

    name = "short"

    def __init__(self, **options):
        super().__init__(**{**options, "duration": 5.0})
'''
ENTRY_POINTS = """
[cornercase.metrics]
speed-difference = of_another:SpeedDifference
[cornercase.features]
vigour = of_another:Vigour
[cornercase.aspects]
pace = of_another:Pace
[cornercase.optimizers]
diagonal = of_another:Diagonal
[cornercase.drivers]
steady = of_another:Steady
[cornercase.simulators]
short = of_another:Short
"""


@pytest.fixture
def site(tmp_path):
    """A folder in which a package with these parts is installed."""
    site = tmp_path / "site"
    (site / "of_another-1.0.dist-info").mkdir(parents=True)
    (site / "of_another.py").write_text(PARTS)
    (site / "of_another-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: of-another\nVersion: 1.0\n"
    )
    (site / "of_another-1.0.dist-info" / "entry_points.txt").write_text(ENTRY_POINTS)
    return site


def test_every_command_takes_the_parts_of_another_package(site, tmp_path):
    explore = "explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian"
    commands = (
        ("metrics",),
        ("simulators",),
        (
            *explore, "--metric", "speed-difference", "--optimizer", "diagonal:begin=0.5", "--simulator", "short",
            "--driver", "Ego=steady", "--budget", 4, "--critical", 5, "--workers", 2, "-o", "study.db",
        ),
        ("analyze", "study.db", "--by", "pace"),
        (*explore, "--metric", "speed-diference", "-o", "other.db"),
    )  # fmt: skip
    ended = process_of_all(commands, cwd=tmp_path, environment={"PYTHONPATH": str(site)})
    metrics, simulators, explored, analyzed, wrong = ended
    assert "speed-difference" in metrics.stdout
    assert "short" in simulators.stdout
    assert explored.returncode == 0, explored.stderr
    with StudyFile.open(tmp_path / "study.db", readonly=True) as study:
        points = [row.point.tolist() for row in study.finished_rows()]
        assert points[0] == pytest.approx([0.5] * 3, abs=0.05)
        assert points[-1] == pytest.approx([1.0] * 3, abs=0.05)
        assert study.recording(1).time[-1] == pytest.approx(5.0, abs=0.051)
        assert analyzed.returncode == 0, analyzed.stderr
        # Here no such package is installed.
        assert read_analysis(study, "pace").unit == "m/s^2"
    # What it does not know is refused in one sentence, with what it knows.
    assert (wrong.returncode, "did you mean 'speed-difference'" in wrong.stderr) == (2, True)


def explore_short(folder):
    """Explore with the other package's simulator in a worker process."""
    return cc.explore(
        X, folder / "study.db", space=SPACE, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol",
        simulator="short", budget=1, timeout=100.0,
    )  # fmt: skip


@pytest.fixture
def inside(site, monkeypatch):
    """Work in the folder of the package, as its author does."""
    monkeypatch.chdir(site)
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    yield site
    sys.modules.pop("of_another", None)


@pytest.mark.parametrize("written", [".", "{site}"])
def test_a_package_on_pythonpath_is_found_by_workers_that_start_in_its_folder(inside, tmp_path, monkeypatch, written):
    monkeypatch.setenv("PYTHONPATH", written.format(site=inside))
    assert explore_short(tmp_path).n_finished == 1


def test_an_editable_package_is_found_by_workers_that_start_in_its_folder(inside, tmp_path, monkeypatch):
    packages = tmp_path / "site-packages"
    packages.mkdir()
    (packages / "of_another.pth").write_text(f"# a comment\nimport sys\n{inside}\n")
    (packages / "broken.pth").write_bytes(b"\xff\xfe\x00")
    monkeypatch.setattr(python_site, "getsitepackages", lambda: [str(packages), str(tmp_path / "none")])
    assert explore_short(tmp_path).n_finished == 1


def test_the_current_folder_is_not_searched_by_workers_for_being_on_the_path(inside, tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "")
    with pytest.raises(
        cc.InputError, match="Worker processes find no simulator 'short', as they do not search the current folder"
    ):
        explore_short(tmp_path)
