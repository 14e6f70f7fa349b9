"""Small scenarios for checks of simulators: twelve that each show one behaviour, and two that an agent drives in."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from cornercase.exploration._paper_examples import examples_folder
from cornercase.scenario import ConcreteScenario

_MOTORWAY: Final = "r157/motorway.xodr"
_CROSSING: Final = "x_intersection/x_intersection.xodr"
LANE_Y: Final = -5.25
"""y in m of the middle of lane -2 of the motorway, along which the ego drives."""

AGENT_SPEED: Final = 5.0
"""Initial speed in m/s of an ego that an agent drives."""


# m; CARLA's behaviour agents do not see a vehicle that is exactly straight ahead.
_VAN_OFFSET: Final = 0.1


class SmallScenario(NamedTuple):
    """Description of a small scenario: name, road, kinds of entities, initial actions, events, and duration in s.

    Entities are named ``Ego``, ``T00`` and so on, since CarMaker uses these names in result files.
    """

    name: str
    road: str
    entities: Mapping[str, str]
    init: Mapping[str, Sequence[str]]
    events: Sequence[str]
    duration: float


def write_small_scenarios(folder: Path, *names: str) -> dict[str, ConcreteScenario]:
    """Write the small scenarios `names` and their roads to a folder; return the concrete scenarios by name.

    Without `names`, the twelve scenarios that need no agent are written.
    """
    concretes = dict[str, ConcreteScenario]()
    for number, scenario in enumerate((*_SMALL_SCENARIOS, *_AGENT_SCENARIOS), 1):
        if scenario.name not in (names or SMALL_SCENARIOS):
            continue
        road = examples_folder() / scenario.road
        if not (folder / road.name).exists():
            shutil.copyfile(road, folder / road.name)
        path = folder / f"{number:02} {scenario.name}.xosc".replace(" ", "_")
        path.write_text(_format_small_scenario(scenario, road.name), encoding="utf-8")
        concretes[scenario.name] = ConcreteScenario(path, {})
    return concretes


def _format_small_scenario(scenario: SmallScenario, road: str) -> str:
    init = "".join(
        f'<Private entityRef="{entity}">{"".join(f"<PrivateAction>{action}</PrivateAction>" for action in actions)}'
        "</Private>"
        for entity, actions in scenario.init.items()
    )
    events = "".join(scenario.events)
    story = (
        f'<Story name="story"><Act name="act">{events}<StartTrigger>{_format_time_condition(0.0)}</StartTrigger>'
        "</Act></Story>"
        if events
        else ""
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO>
<FileHeader revMajor="1" revMinor="0" date="2026-01-01T00:00:00" description="{scenario.name}" author="cornercase"/>
<CatalogLocations/>
<RoadNetwork><LogicFile filepath="{road}"/></RoadNetwork>
<Entities>{"".join(_ENTITIES[kind](name) for name, kind in scenario.entities.items())}</Entities>
<Storyboard><Init><Actions>{init}</Actions></Init>{story}
<StopTrigger>{_format_time_condition(scenario.duration)}</StopTrigger></Storyboard>
</OpenSCENARIO>
"""


def _format_vehicle(name: str, length: float, width: float, center: float) -> str:
    return f"""<ScenarioObject name="{name}"><Vehicle name="{name}" vehicleCategory="car"><ParameterDeclarations/>
<BoundingBox><Center x="{center}" y="0" z="0.75"/>
<Dimensions width="{width}" length="{length}" height="1.5"/></BoundingBox>
<Performance maxSpeed="70" maxAcceleration="10" maxDeceleration="10"/>
<Axles><FrontAxle maxSteering="0.6" wheelDiameter="0.6" trackWidth="1.6" positionX="2.8" positionZ="0.3"/>
<RearAxle maxSteering="0" wheelDiameter="0.6" trackWidth="1.6" positionX="0" positionZ="0.3"/></Axles>
<Properties/></Vehicle></ScenarioObject>"""


def _format_walker(name: str) -> str:
    return f"""<ScenarioObject name="{name}">
<Pedestrian name="{name}" model="walker" mass="75" pedestrianCategory="pedestrian"><ParameterDeclarations/>
<BoundingBox><Center x="0" y="0" z="0.9"/><Dimensions width="0.6" length="0.4" height="1.8"/></BoundingBox>
<Properties/></Pedestrian></ScenarioObject>"""


_ENTITIES: Final[Mapping[str, Callable[[str], str]]] = {
    "car": partial(_format_vehicle, length=4.5, width=1.8, center=1.4),
    "van": partial(_format_vehicle, length=6.0, width=2.1, center=1.9),
    "walker": _format_walker,
}


def _format_teleport_action(x: float, y: float, heading: float = 0.0) -> str:
    return f"<TeleportAction><Position>{_format_world_position(x, y, heading)}</Position></TeleportAction>"


def _format_world_position(x: float, y: float, heading: float = 0.0) -> str:
    return f'<WorldPosition x="{x}" y="{y}" z="0" h="{heading}" p="0" r="0"/>'


def _format_speed_action(value: float, shape: str = "step", seconds: float = 0.0) -> str:
    return f"""<LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="{shape}" value="{seconds}" dynamicsDimension="time"/>
<SpeedActionTarget><AbsoluteTargetSpeed value="{value}"/></SpeedActionTarget></SpeedAction></LongitudinalAction>"""


def _format_lane_change(lane: int, seconds: float) -> str:
    return f"""<LateralAction><LaneChangeAction>
<LaneChangeActionDynamics dynamicsShape="sinusoidal" value="{seconds}" dynamicsDimension="time"/>
<LaneChangeTarget><AbsoluteTargetLane value="{lane}"/></LaneChangeTarget></LaneChangeAction></LateralAction>"""


def _format_trajectory_action(vertices: Sequence[tuple[float, float, float, float]], *, has_times: bool = True) -> str:
    """Return the XML of an action along a trajectory; a vertex has time in s, x and y in m, and heading in rad."""
    points = "".join(
        f'<Vertex time="{time}"><Position>{_format_world_position(x, y, heading)}</Position></Vertex>'
        for time, x, y, heading in vertices
    )
    timing = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>' if has_times else "<None/>"
    return f"""<RoutingAction><FollowTrajectoryAction>
<Trajectory name="way" closed="false"><ParameterDeclarations/><Shape><Polyline>{points}</Polyline></Shape></Trajectory>
<TimeReference>{timing}</TimeReference><TrajectoryFollowingMode followingMode="position"/>
</FollowTrajectoryAction></RoutingAction>"""


def _format_route_action(x: float, y: float) -> str:
    position = _format_world_position(x, y)
    return f"""<RoutingAction><AcquirePositionAction><Position>{position}</Position></AcquirePositionAction>
</RoutingAction>"""


def _format_synchronize_action(master: str, own: tuple[float, float], target: tuple[float, float]) -> str:
    of_master, of_own = _format_world_position(*target), _format_world_position(*own)
    return f"""<SynchronizeAction masterEntityRef="{master}">
<TargetPositionMaster>{of_master}</TargetPositionMaster><TargetPosition>{of_own}</TargetPosition>
</SynchronizeAction>"""


def _format_story_event(entity: str, action: str, condition: str) -> str:
    name = f"{entity} {len(action)} {len(condition)}"
    return f"""<ManeuverGroup name="group of {name}" maximumExecutionCount="1">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="{entity}"/></Actors>
<Maneuver name="maneuver of {name}">
<Event name="event of {name}" priority="overwrite"><Action name="action of {name}">
<PrivateAction>{action}</PrivateAction></Action><StartTrigger>{condition}</StartTrigger></Event></Maneuver></ManeuverGroup>"""


def _format_time_condition(seconds: float) -> str:
    return f"""<ConditionGroup><Condition name="time" delay="0" conditionEdge="none"><ByValueCondition>
<SimulationTimeCondition value="{seconds}" rule="greaterThan"/></ByValueCondition></Condition></ConditionGroup>"""


def _format_distance_condition(entity: str, other: str, distance: float) -> str:
    return f"""<ConditionGroup><Condition name="near" delay="0" conditionEdge="none"><ByEntityCondition>
<TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="{entity}"/></TriggeringEntities>
<EntityCondition><RelativeDistanceCondition entityRef="{other}" relativeDistanceType="cartesianDistance"
value="{distance}" freespace="false" rule="lessThan"/></EntityCondition>
</ByEntityCondition></Condition></ConditionGroup>"""


_SMALL_SCENARIOS: Final = (
    SmallScenario(
        "constant speed",
        _MOTORWAY,
        {"Ego": "car"},
        {"Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(20)]},
        [],
        6.0,
    ),
    SmallScenario(
        "braking to a stop",
        _MOTORWAY,
        {"Ego": "car"},
        {"Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(20)]},
        [_format_story_event("Ego", _format_speed_action(0, "linear", 4.0), _format_time_condition(1.0))],
        7.0,
    ),
    SmallScenario(
        "smooth change of speed",
        _MOTORWAY,
        {"Ego": "car"},
        {"Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(10)]},
        [_format_story_event("Ego", _format_speed_action(25, "sinusoidal", 5.0), _format_time_condition(0.5))],
        7.0,
    ),
    SmallScenario(
        "lane change",
        _MOTORWAY,
        {"Ego": "car"},
        {"Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(20)]},
        [_format_story_event("Ego", _format_lane_change(-1, 4.0), _format_time_condition(1.0))],
        7.0,
    ),
    SmallScenario(
        "two that pass each other",
        _MOTORWAY,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(25)],
            "T00": [_format_teleport_action(140, -1.75), _format_speed_action(15)],
        },
        [],
        8.0,
    ),
    SmallScenario(
        "a leader that brakes when the ego is near",
        _MOTORWAY,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(20)],
            "T00": [_format_teleport_action(200, LANE_Y), _format_speed_action(10)],
        },
        [
            _format_story_event(
                "T00", _format_speed_action(5, "linear", 2.0), _format_distance_condition("Ego", "T00", 60.0)
            ),
            _format_story_event(
                "Ego", _format_speed_action(5, "linear", 3.0), _format_distance_condition("Ego", "T00", 50.0)
            ),
        ],
        9.0,
    ),
    SmallScenario(
        "a trajectory with times",
        _CROSSING,
        {"Ego": "car", "T00": "walker"},
        {
            "Ego": [_format_teleport_action(-40, -1.75), _format_speed_action(8)],
            "T00": [_format_teleport_action(18, 4.6, -1.5708)],
        },
        [
            _format_story_event(
                "T00",
                _format_trajectory_action([(0, 18, 4.6, -1.5708), (2, 18, 2.0, -1.5708), (5, 18, -5.0, -1.5708)]),
                _format_time_condition(0.5),
            )
        ],
        5.0,
    ),
    SmallScenario(
        "a trajectory at the entity's own speed",
        _MOTORWAY,
        {"Ego": "car"},
        {"Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(15)]},
        [
            _format_story_event(
                "Ego",
                # It begins where the ego is then, since a jump may come a time step earlier or later.
                _format_trajectory_action(
                    [(0, 108.25, LANE_Y, 0), (0, 150, LANE_Y, 0), (0, 200, LANE_Y + 4.0, 0.08)],
                    has_times=False,
                ),
                _format_time_condition(0.5),
            )
        ],
        5.0,
    ),
    SmallScenario(
        "a standing van is hit from behind",
        _MOTORWAY,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(15)],
            "T00": [_format_teleport_action(150, LANE_Y), _format_speed_action(0)],
        },
        [],
        5.0,
    ),
    SmallScenario(
        "a walker is hit from the side",
        _MOTORWAY,
        {"Ego": "car", "T00": "walker"},
        {
            "Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(10)],
            "T00": [_format_teleport_action(130, LANE_Y - 4.0, 1.5708)],
        },
        [
            _format_story_event(
                "T00",
                _format_trajectory_action([(0, 130, LANE_Y - 4.0, 1.5708), (4, 130, LANE_Y + 4.0, 1.5708)]),
                _format_time_condition(0.5),
            )
        ],
        4.3,
    ),
    SmallScenario(
        "a stop 0.4 m behind a van",
        _MOTORWAY,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [_format_teleport_action(100, LANE_Y), _format_speed_action(10)],
            "T00": [_format_teleport_action(130.4, LANE_Y), _format_speed_action(0)],
        },
        # It goes about 5 m, and 20 m while it brakes; its front is 3.65 m ahead of its rear axle, the van's rear 1.1 m
        # behind its own.
        [_format_story_event("Ego", _format_speed_action(0, "linear", 4.0), _format_time_condition(0.5))],
        6.0,
    ),
    SmallScenario(
        "an arrival at the same time",
        _CROSSING,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [_format_teleport_action(-40, -1.75), _format_speed_action(9)],
            "T00": [_format_teleport_action(39.9, 1.75, 3.1416), _format_speed_action(4)],
        },
        [
            _format_story_event(
                "T00", _format_synchronize_action("Ego", (12.0, 1.75), (-10.0, -1.75)), _format_time_condition(0.5)
            )
        ],
        5.0,
    ),
)

SMALL_SCENARIOS: Final = tuple(scenario.name for scenario in _SMALL_SCENARIOS)
"""Names of the twelve small scenarios without agents, in order."""

_AGENT_SCENARIOS: Final[tuple[SmallScenario, ...]] = (
    SmallScenario(
        "a free lane",
        _MOTORWAY,
        {"Ego": "car"},
        {
            "Ego": [
                _format_teleport_action(100, LANE_Y),
                _format_speed_action(AGENT_SPEED),
                _format_route_action(400, LANE_Y),
            ]
        },
        [],
        6.0,
    ),
    SmallScenario(
        "a standing van",
        _MOTORWAY,
        {"Ego": "car", "T00": "van"},
        {
            "Ego": [
                _format_teleport_action(100, LANE_Y),
                _format_speed_action(AGENT_SPEED),
                _format_route_action(400, LANE_Y),
            ],
            "T00": [_format_teleport_action(150, LANE_Y + _VAN_OFFSET), _format_speed_action(0)],
        },
        [],
        12.0,
    ),
)

AGENT_DURATIONS: Final = {scenario.name: scenario.duration for scenario in _AGENT_SCENARIOS}
"""Durations in s of the scenarios in which an agent drives the ego straight on along its route, by name."""
