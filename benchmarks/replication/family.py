"""The family: what the paper leaves open of its scenarios and of its analysis, and what is taken here.

`RUNS` are reconstructions of the scenarios: other runs. `READINGS` are ways of comparing and judging the same runs. The
first of each is the documented default. The settings in `BY_HAND` were chosen with seeds 100 to 102, anew
after those of two seeds had held for 3 of the first 5 that are shown; reconstructions from the space of what is left
open, with seed 200.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._paper_examples import examples_folder, paper_experiment_config
from cornercase.scenario import LogicalScenario

PAPER_GAMMA: Final = 100.0
"""The only setting of its clustering that the paper states."""


@dataclass(frozen=True)
class Reading:
    """How runs are compared and judged.

    `trajectory` is the aspect that is taken for the ego's trajectory. `settings` has eps and min_samples by aspect,
    with the paper's gamma for distances divided by the largest one; None for automatic settings. `cause` says who
    causes an accident: by the rules of the road, or who runs into whom. `interpreted` is DTW in plain Python.
    """

    name: str
    says: str
    trajectory: str = "ego-trajectory"
    settings: Mapping[str, tuple[float, int]] | None = None
    cause: str = "fault"
    interpreted: bool = False


@dataclass(frozen=True)
class Runs:
    """A reconstruction of one scenario: the driver of each of the paper's egos, and what differs from the example."""

    name: str
    scenario: str
    says: str
    egos: Mapping[str, str | None]
    readings: tuple[str, ...]
    changes: tuple[tuple[str, str], ...] = ()
    ranges: tuple[str, ...] = ()

    def config(self, ego: str, seed: int, budget: int | None, folder: Path) -> ExplorationConfig:
        """Return the configuration of its exploration; changed files are written to the folder."""
        config = paper_experiment_config(self.scenario, budget=budget, seed=seed, driver=self.egos[ego])
        given = {**vars(config), "optimizer": "bayes:filling=0"}
        if self.changes or self.ranges:
            stem = self.scenario.replace("-", "_")
            files = folder / self.name
            files.mkdir(parents=True, exist_ok=True)
            for source in sorted((examples_folder() / stem).iterdir()):
                text = source.read_text("utf-8")
                for old, new in self.changes if source.name == f"{stem}.xosc" else ():
                    if old not in text:
                        raise ValueError(f"{source}: has no {old}")
                    text = text.replace(old, new)
                if not (files / source.name).exists():
                    (files / source.name).write_text(text, "utf-8")
            given["logical"] = LogicalScenario.read(files / f"{stem}.xosc", files / f"{stem}.space.xosc", self.ranges)
        return ExplorationConfig(**given)


# What CARLA's behaviour agents (agents/navigation/behavior_agent.py and behavior_types.py) take into account of other
# vehicles: those within 30 degrees of straight ahead and within the larger of a threshold of 12, 10 or 8 m and a third
# of the speed limit (36 km/h here), in each frame anew; 3 s to a leader; a speed of 6, 3 or 1 km/h below the limit.
_CARLA: Final = "field_of_view=1.047,sight_range=12,reaction_time=0,memory=0,safety_time=3"

_C_SPEED: Final = 'name="c_speed" parameterType="double" value="{}"'

BY_HAND: Final[Mapping[str, tuple[float, int]]] = {
    "ego-trajectory": (0.3, 6),
    "ego-motion": (0.3, 9),
    "trajectory-distance": (0.16, 9),
    "wttc": (0.275, 12),
    "distance": (0.3, 6),
    "traffic-quality": (0.3, 6),
}
"""eps and min. points by aspect; the paper does not state its own.

Those of scenario 1 are in the middle of what divides *corner* as the paper says with each of the seeds 100 to 102.
"""

READINGS: Final = (
    Reading(
        "automatic", "automatic settings; a trajectory is a sequence of positions; accidents by the rules of the road"
    ),
    Reading(
        "by hand",
        "gamma of 100 for distances divided by the largest one, eps and min. points by aspect",
        settings=BY_HAND,
    ),
    Reading(
        "speed, by hand",
        "settings *by hand*; a trajectory is a sequence of positions and speeds (aspect `ego-motion`)",
        trajectory="ego-motion",
        settings=BY_HAND,
    ),
    Reading("contact", "an accident is caused by C if its front hits the ego, else by the ego", cause="contact"),
    Reading("plain Python", "DTW in Python, cell by cell of a NumPy array", interpreted=True),
)

RUNS: Final = (
    Runs(
        "example-x",
        "x-intersection",
        "`examples/x_intersection`",
        {"": None},
        ("automatic",),
    ),
    Runs(
        "corner",
        "x-intersection",
        "the same, with the critical diagonal in the bottom left corner, and everybody arrives: 4 to 15 s of waiting,"
        " 10 m from the middle of the road, the ego starts at 20 to 95 m, a run lasts 33 s",
        {"": None},
        ("speed, by hand",),
        changes=(
            (
                '<WorldPosition x="18.000" y="4.600" h="-1.5708"/>',
                '<WorldPosition x="18.000" y="10.000" h="-1.5708"/>',
            ),
            (
                '<SimulationTimeCondition value="30" rule="greaterThan"/>',
                '<SimulationTimeCondition value="33" rule="greaterThan"/>',
            ),
            # No end where the ego arrives: this place is not on its way.
            ('<LanePosition roadId="2" laneId="1" s="40"/>', '<LanePosition roadId="1" laneId="1" s="0"/>'),
        ),
        ranges=("ego_start=20:95:0.1", "pedestrian_wait=4:15:0.01"),
    ),
    # Found in the space of reconstructions (`open_choices.py`), with its seed.
    Runs(
        "far",
        "x-intersection",
        "the same, with the pedestrian 10.7 m from the middle of the road, who walks at 1.5 m/s after 2.5 to 11 s, and"
        " the ego at 11.5 m/s from 34 to 95 m on",
        {"": None},
        ("by hand", "speed, by hand"),
        changes=(
            (
                '<WorldPosition x="18.000" y="4.600" h="-1.5708"/>',
                '<WorldPosition x="18.000" y="10.700" h="-1.5708"/>',
            ),
            (
                'name="ego_speed" parameterType="double" value="10"',
                'name="ego_speed" parameterType="double" value="11.5"',
            ),
            (
                'name="pedestrian_speed" parameterType="double" value="2.2"',
                'name="pedestrian_speed" parameterType="double" value="1.5"',
            ),
        ),
        ranges=("ego_start=34:95:0.1", "pedestrian_wait=2.5:11:0.01"),
    ),
    Runs(
        "example-t",
        "t-intersection",
        "`examples/t_intersection`, with the drivers of these names",
        {"cautious": "cautious", "normal": "normal", "aggressive": "aggressive"},
        ("automatic", "by hand", "contact", "plain Python"),
    ),
    Runs(
        "carla",
        "t-intersection",
        "the same, with egos that see of others what CARLA's agents of these names do: 30° to both sides, 12 m",
        {
            "cautious": f"cautious:target_share=0.83,{_CARLA}",
            "normal": f"normal:target_share=0.92,{_CARLA}",
            "aggressive": f"aggressive:target_share=0.97,{_CARLA}",
        },
        ("automatic", "by hand", "contact", "plain Python"),
    ),
    # As *far*: for each ego the one of the space in which 2.4 and most other statements hold.
    Runs(
        "near sight",
        "t-intersection",
        "the same, with a cautious ego that sees 115° to both sides, 12 m, reacts after 0.1 s and keeps 2.5 s to a"
        " leader; C drives at 12.5 m/s and starts after up to 7.5 s",
        {"cautious": "cautious:field_of_view=4,sight_range=12,reaction_time=0.1,memory=0,safety_time=2.5"},
        ("by hand", "contact"),
        changes=((_C_SPEED.format(10), _C_SPEED.format(12.5)),),
        ranges=("c_start_time=0:7.5:0.01",),
    ),
    Runs(
        "slow C",
        "t-intersection",
        "the same, with an aggressive ego that sees 86° to both sides, 50 m, reacts after 0.2 s and keeps 4 s to a"
        " leader; C drives at 7 m/s and starts after up to 3.5 s",
        {"aggressive": "aggressive:field_of_view=3,sight_range=50,reaction_time=0.2,memory=0,safety_time=4"},
        ("by hand", "contact"),
        changes=((_C_SPEED.format(10), _C_SPEED.format(7)),),
        ranges=("c_start_time=0:3.5:0.01",),
    ),
)
DEFAULTS: Final = {"x-intersection": ("example-x", "automatic"), "t-intersection": ("example-t", "automatic")}
