"""Random storyboards on roads of our own: what examples combine rarely.

A storyboard is drawn from a `random.Random`, so that a seed gives it again; hypothesis hands in one that it can shrink.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

VERSION = 10
"""Grows when a seed no longer gives the same storyboard."""


@dataclass(frozen=True)
class Road:
    """A road file: its road's lanes to drive in, and where on it entities begin."""

    lanes: tuple[int, ...]
    begin: tuple[float, float]
    geometry: tuple[tuple[str, float, tuple[float, ...]], ...]
    """Kind, length and curvatures of the pieces of the reference line."""


ROADS = {
    "straight": Road((-2, -1, 1, 2), (20.0, 250.0), (("line", 900.0, ()),)),
    "curve": Road(
        (-2, -1, 1),
        (10.0, 160.0),
        (
            ("line", 80.0, ()), ("spiral", 60.0, (0.0, 0.01)), ("arc", 250.0, (0.01,)), ("spiral", 60.0, (0.01, 0.0)),
            ("line", 100.0, ()), ("arc", 200.0, (-0.005,)), ("line", 300.0, ()),
        ),
    ),
    "motorway": Road((-4, -3, -2, -1), (50.0, 400.0), (("line", 200.0, ()), ("arc", 1800.0, (0.0008,)))),
}  # fmt: skip

SHAPES = ("linear", "cubic", "sinusoidal", "step")
RULES = ("greaterThan", "lessThan", "greaterOrEqual", "lessOrEqual")
_ANSWERING = tuple(
    f"<{kind}Condition"
    for kind in (
        "TimeHeadway", "TimeToCollision", "StandStill", "EndOfRoad", "Offroad", "Collision", "ReachPosition",
    )
)  # fmt: skip


def write_roads(folder: Path) -> None:
    """Write the road files that storyboards refer to."""
    for name, road in ROADS.items():
        (folder / f"{name}.xodr").write_text(_road_file(road), encoding="utf-8")


def _road_file(road: Road) -> str:
    plan, s, x, y, heading = "", 0.0, 0.0, 0.0, 0.3
    for kind, length, values in road.geometry:
        names = {"line": (), "arc": ("curvature",), "spiral": ("curvStart", "curvEnd")}[kind]
        inner = " ".join(f'{key}="{value}"' for key, value in zip(names, values, strict=True))
        plan += (
            f'<geometry s="{s}" x="{x!r}" y="{y!r}" hdg="{heading!r}" length="{length}"><{kind} {inner}/></geometry>'
        )
        first, last = (values[0], values[-1]) if values else (0.0, 0.0)
        pieces = 20000
        step = length / pieces
        for k in range(pieces):
            # The midpoint rule, whose error is far below a micrometre here.
            along = (k + 0.5) * step
            turned = heading + first * along + 0.5 * (last - first) / length * along**2
            x, y = x + step * math.cos(turned), y + step * math.sin(turned)
        heading += 0.5 * (first + last) * length
        s += length
    sides = ""
    for side, lanes in (("left", [k for k in road.lanes if k > 0][::-1]), ("right", [k for k in road.lanes if k < 0])):
        lanes = sorted(lanes, reverse=True)
        if lanes:
            lane = '<lane id="{}" type="driving" level="false"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
            sides += f"<{side}>{''.join(lane.format(k) for k in lanes)}</{side}>"
        if side == "left":
            sides += '<center><lane id="0" type="none" level="false"/></center>'
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenDRIVE><header revMajor="1" revMinor="6" name="" version="1" date="2026-01-01T00:00:00"/>
<road name="" length="{s}" id="1" junction="-1"><planView>{plan}</planView><lanes><laneSection s="0">{sides}</laneSection>
</lanes></road></OpenDRIVE>
"""


@dataclass
class _Plan:
    """What a storyboard is drawn from, and the names that it has given so far."""

    random: Random
    road: Road
    entities: list[str]
    elements: list[tuple[str, str]] = field(default_factory=list)
    steady: list[str] = field(default_factory=list)
    """Entities that change no lanes, of which conditions may ask the acceleration.

    Where a lane change ends, esmini looks the place up anew and moves it by some millimetres: 2 m/s² for a frame."""
    # Whoever changes lanes or follows a trajectory at its own speed, esmini puts back there in each step, whatever
    # distance is to be kept rigidly: an entity does either.
    guided: set[str] = field(default_factory=set)
    rigid: set[str] = field(default_factory=set)

    def number(self, low: float, high: float, digits: int = 1) -> float:
        return round(self.random.uniform(low, high), digits)

    def one(self, choices: Sequence[str]) -> str:
        return self.random.choice(choices)

    def chance(self, share: float) -> bool:
        return self.random.random() < share

    def flag(self) -> str:
        return self.one(("true", "false"))

    def other(self, entity: str) -> str:
        return self.one([name for name in self.entities if name != entity])


def storyboard(random: Random) -> str:
    """Draw an OpenSCENARIO file, which lies beside the files of `write_roads`."""
    kind = random.choice(list(ROADS))
    plan = _Plan(random, ROADS[kind], ["Ego", "A", "B", "C"][: random.randint(2, 4)])
    plan.steady = [name for name in plan.entities if plan.chance(0.4)]
    entities = "".join(_entity(plan, name) for name in plan.entities)
    init = "".join(_init(plan, name) for name in plan.entities)
    # Names first, so that conditions can refer to what comes later.
    shape = [[random.randint(1, 3) for _ in range(random.randint(1, 2))] for _ in range(random.randint(1, 3))]
    for g, maneuvers in enumerate(shape):
        plan.elements.append(("maneuverGroup", f"g{g}"))
        for m, events in enumerate(maneuvers):
            plan.elements.append(("maneuver", f"m{g}{m}"))
            plan.elements += [("event", f"e{g}{m}{e}") for e in range(events)]
            plan.elements += [("action", f"a{g}{m}{e}0") for e in range(events)]
    groups = "".join(_group(plan, g, maneuvers) for g, maneuvers in enumerate(shape))
    if "<LaneOffsetAction" in groups:
        # Where a lane offset ends, the total acceleration points straight across the heading: whether esmini counts it
        # as negative then is a matter of rounding.
        groups = groups.replace("<AccelerationCondition ", '<AccelerationCondition direction="longitudinal" ')
    stop = _group_of([_time(plan, "stop", plan.number(6, 18), "greaterThan")])
    if plan.chance(0.15) and "TimeToCollision" not in (early := _condition(plan, "stop1")):
        stop += _group_of([early])
    end = f"<StopTrigger>{_group_of([_condition(plan, 'actstop')])}</StopTrigger>" if plan.chance(0.1) else ""
    # In the first frame, esmini measures a time to collision to an entity as if that stood; the standard does not.
    earliest = 0.1 if "TimeToCollision" in groups + end else 0.0
    begin = _group_of([_time(plan, "act", plan.number(0.1, 2) if plan.chance(0.3) else earliest, "greaterOrEqual")])
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<OpenSCENARIO><FileHeader revMajor="1" revMinor="3" date="2026-01-01T00:00:00" description="random storyboard" author="cornercase"/>
<CatalogLocations/><RoadNetwork><LogicFile filepath="{kind}.xodr"/></RoadNetwork>
<Entities>{entities}</Entities>
<Storyboard><Init><Actions>
{init}</Actions></Init>
<Story name="story"><Act name="act">
{groups}<StartTrigger>{begin}</StartTrigger>{end}</Act></Story>
<StopTrigger>{stop}</StopTrigger></Storyboard></OpenSCENARIO>
"""


def _entity(plan: _Plan, name: str) -> str:
    kind, length, width, center = plan.random.choice(
        [("car", 4.2, 1.8, 1.4), ("car", 5.0, 2.0, 1.4), ("truck", 11.5, 2.5, 4.0), ("motorbike", 2.2, 0.8, 0.6)]
    )
    up, down = plan.random.choice([3, 5, 20]), plan.random.choice([6, 10, 20])
    return f"""<ScenarioObject name="{name}"><Vehicle name="{kind}" vehicleCategory="{kind}">
<BoundingBox><Center x="{center}" y="0" z="0.75"/><Dimensions width="{width}" length="{length}" height="1.5"/></BoundingBox>
<Performance maxSpeed="{plan.random.choice([40, 69])}" maxAcceleration="{up}" maxDeceleration="{down}"/>
<Axles><FrontAxle maxSteering="0.5" wheelDiameter="0.6" trackWidth="1.6" positionX="2.9" positionZ="0.3"/>
<RearAxle maxSteering="0" wheelDiameter="0.6" trackWidth="1.6" positionX="0" positionZ="0.3"/></Axles><Properties/></Vehicle>
</ScenarioObject>
"""


def _lane_position(plan: _Plan) -> str:
    lane, offset = plan.random.choice(plan.road.lanes), plan.number(-0.5, 0.5, 2) if plan.chance(0.3) else 0
    return f'<LanePosition roadId="1" laneId="{lane}" s="{plan.number(*plan.road.begin)}" offset="{offset}"/>'


def _init(plan: _Plan, name: str) -> str:
    place = _lane_position(plan)
    if name == "C" and plan.chance(0.3):
        place = f'<RelativeLanePosition entityRef="Ego" dLane="0" ds="{plan.number(15, 60)}"/>'
    speed = _speed(f'<AbsoluteTargetSpeed value="{plan.number(0, 25) if plan.chance(0.9) else 0}"/>', "step", "time", 0)
    teleport = f"<PrivateAction><TeleportAction><Position>{place}</Position></TeleportAction></PrivateAction>"
    return f'<Private entityRef="{name}">{teleport}<PrivateAction>{speed}</PrivateAction></Private>\n'


def _group(plan: _Plan, g: int, maneuvers: list[int]) -> str:
    actor = plan.one(plan.entities)
    inner = "".join(
        f'<Maneuver name="m{g}{m}">{"".join(_event(plan, f"{g}{m}{e}", actor) for e in range(events))}</Maneuver>\n'
        for m, events in enumerate(maneuvers)
    )
    times = 2 if plan.chance(0.1) and not _only_once(inner) else 1
    return f"""<ManeuverGroup name="g{g}" maximumExecutionCount="{times}">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors>
{inner}</ManeuverGroup>
"""


def _event(plan: _Plan, number: str, actor: str) -> str:
    actions = "".join(
        f'<Action name="a{number}{k}"><PrivateAction>{_action(plan, actor)}</PrivateAction></Action>\n'
        for k in range(2 if plan.chance(0.2) else 1)
    )
    groups = "".join(
        _group_of([_condition(plan, f"c{number}{k}{j}") for j in range(2 if plan.chance(0.25) else 1)])
        for k in range(2 if plan.chance(0.15) else 1)
    )
    times = 1 if _only_once(actions) else plan.random.choice([1, 1, 1, 2, 3])
    priority = plan.one(("override", "parallel", "skip"))
    return f"""<Event name="e{number}" priority="{priority}" maximumExecutionCount="{times}">
{actions}<StartTrigger>{groups}</StartTrigger></Event>
"""


def _only_once(actions: str) -> bool:
    """Whether they hold an action that esmini does not begin anew: run again, it goes on from what it has measured."""
    begun = '<SpeedActionDynamics dynamicsShape="{}" dynamicsDimension="distance"'
    return "<SynchronizeAction" in actions or any(begun.format(shape) in actions for shape in SHAPES)


def _action(plan: _Plan, actor: str) -> str:
    draw = plan.random.choices(
        (_absolute_speed, _relative_speed, _lane_change, _lane_offset, _distance, _teleport, _speed_profile, _trajectory,
         _synchronise),
        (22, 14, 24, 8, 14, 6, 4, 4, 3),
    )[0]  # fmt: skip
    return draw(plan, actor)


def _dynamics(plan: _Plan, lateral: bool) -> tuple[str, str, float]:
    shape, dimension = plan.one(SHAPES), plan.one(("time", "time", "distance", "rate"))
    if shape == "step":
        return shape, "time", 0.0
    low, high = {"time": (1, 6), "distance": (15, 90), "rate": (0.5, 2) if lateral else (0.5, 5)}[dimension]
    return shape, dimension, plan.number(low, high)


def _speed(target: str, shape: str, dimension: str, value: float) -> str:
    return f"""<LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}"
value="{value}"/><SpeedActionTarget>{target}</SpeedActionTarget></SpeedAction></LongitudinalAction>"""


def _absolute_speed(plan: _Plan, actor: str) -> str:
    return _speed(f'<AbsoluteTargetSpeed value="{plan.number(0, 25)}"/>', *_dynamics(plan, False))


def _relative_speed(plan: _Plan, actor: str) -> str:
    kind = plan.one(("delta", "delta", "factor"))
    value = plan.number(-6, 6) if kind == "delta" else plan.number(0.5, 1.5, 2)
    dynamics, continuous = _dynamics(plan, False), "false"
    if plan.chance(0.15):
        # The standard has a continuous relative speed neither with time nor with distance.
        dynamics, continuous = ("step", "time", 0.0), "true"
    target = f"""<RelativeTargetSpeed entityRef="{plan.other(actor)}" value="{value}" speedTargetValueType="{kind}"
continuous="{continuous}"/>"""
    return _speed(target, *dynamics)


def _lane_change(plan: _Plan, actor: str) -> str:
    if actor in plan.steady:
        return _lane_offset(plan, actor)
    if actor in plan.rigid:
        return _lane_offset(plan, actor)
    plan.guided.add(actor)
    shape, dimension, value = _dynamics(plan, True)
    if plan.chance(0.6):
        target = f'<AbsoluteTargetLane value="{plan.random.choice(plan.road.lanes)}"/>'
    else:
        # A neighbouring lane need not be there.
        target = f'<RelativeTargetLane entityRef="{plan.other(actor)}" value="0"/>'
    offset = f' targetLaneOffset="{plan.number(-0.5, 0.5, 2)}"' if plan.chance(0.2) else ""
    return f"""<LateralAction><LaneChangeAction{offset}><LaneChangeActionDynamics dynamicsShape="{shape}"
dynamicsDimension="{dimension}" value="{value}"/><LaneChangeTarget>{target}</LaneChangeTarget></LaneChangeAction></LateralAction>"""


def _lane_offset(plan: _Plan, actor: str) -> str:
    value = plan.number(-1.2, 1.2, 2)
    if plan.chance(0.75):
        target = f'<AbsoluteTargetLaneOffset value="{value}"/>'
    else:
        target = f'<RelativeTargetLaneOffset entityRef="{plan.other(actor)}" value="{value}"/>'
    most = f' maxLateralAcc="{plan.number(0.3, 3)}"' if plan.chance(0.8) else ""
    return f"""<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="{plan.one(SHAPES)}"{most}/>
<LaneOffsetTarget>{target}</LaneOffsetTarget></LaneOffsetAction></LateralAction>"""


def _distance(plan: _Plan, actor: str) -> str:
    wanted = f'distance="{plan.number(5, 40)}"' if plan.chance(0.6) else f'timeGap="{plan.number(0.8, 3)}"'
    limits = f"""<DynamicConstraints maxAcceleration="{plan.number(1, 6)}" maxDeceleration="{plan.number(2, 9)}"
maxSpeed="{plan.number(10, 40)}"/>"""
    side = plan.one(("trailingReferencedEntity", "leadingReferencedEntity", "any"))
    displacement = f' displacement="{side}"' if plan.chance(0.4) else ""
    if actor in plan.guided or plan.chance(0.8):
        held = limits
    else:
        held = ""
        plan.rigid.add(actor)
    return f"""<LongitudinalAction><LongitudinalDistanceAction entityRef="{plan.other(actor)}" {wanted} freespace="{plan.flag()}"
continuous="{plan.flag()}" coordinateSystem="{plan.one(("entity", "lane", "road"))}"{displacement}>{held}
</LongitudinalDistanceAction></LongitudinalAction>"""


def _teleport(plan: _Plan, actor: str) -> str:
    position = _lane_position(plan)
    if plan.chance(0.3):
        position = f'<RelativeLanePosition entityRef="{plan.other(actor)}" dLane="0" ds="{plan.number(10, 50)}"/>'
    return f"<TeleportAction><Position>{position}</Position></TeleportAction>"


def _speed_profile(plan: _Plan, actor: str) -> str:
    entries = "".join(
        f'<SpeedProfileEntry speed="{plan.number(0, 20)}" time="{plan.number(1, 4)}"/>'
        for _ in range(plan.random.randint(1, 3))
    )
    return f"""<LongitudinalAction><SpeedProfileAction followingMode="{plan.one(("position", "follow"))}"><DynamicConstraints
maxAcceleration="6" maxDeceleration="8" maxAccelerationRate="4" maxDecelerationRate="4" maxSpeed="40"/>{entries}
</SpeedProfileAction></LongitudinalAction>"""


def _trajectory(plan: _Plan, actor: str) -> str:
    lane, s = plan.random.choice(plan.road.lanes), plan.number(*plan.road.begin)
    # Against the road's s it begins so far on that all vertices, at most five steps, lie on the road.
    s, onward = (s, 1.0) if lane < 0 else (s + 5 * 25.0, -1.0)
    timed, time, vertices = actor in plan.rigid or plan.chance(0.5), 0.0, ""
    if not timed:
        plan.guided.add(actor)
    for _ in range(plan.random.randint(3, 6)):
        position = f'<LanePosition roadId="1" laneId="{lane}" s="{s:.1f}" offset="{plan.number(-0.8, 0.8, 2)}"/>'
        vertices += f'<Vertex time="{time:.2f}"><Position>{position}</Position></Vertex>\n'
        step = plan.number(8, 25)
        s, time = s + onward * step, time + plan.number(0.8, 2.5, 2)
    timing = '<Timing domainAbsoluteRelative="relative" scale="1" offset="0"/>' if timed else "<None/>"
    return f"""<RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="false"><Shape><Polyline>
{vertices}</Polyline></Shape></Trajectory></TrajectoryRef><TimeReference>{timing}</TimeReference>
<TrajectoryFollowingMode followingMode="{plan.one(("position", "follow"))}"/></FollowTrajectoryAction></RoutingAction>"""


def _synchronise(plan: _Plan, actor: str) -> str:
    final = f'<FinalSpeed><AbsoluteSpeed value="{plan.number(2, 20)}"/></FinalSpeed>' if plan.chance(0.5) else ""
    places = []
    for _ in range(2):
        lane = plan.random.choice([k for k in plan.road.lanes if k < 0])
        places.append(f'<LanePosition roadId="1" laneId="{lane}" s="{plan.number(plan.road.begin[1], 420)}"/>')
    return f"""<SynchronizeAction masterEntityRef="{plan.other(actor)}" targetTolerance="1" targetToleranceMaster="1">
<TargetPositionMaster>{places[0]}</TargetPositionMaster><TargetPosition>{places[1]}</TargetPosition>{final}</SynchronizeAction>"""


def _group_of(conditions: list[str]) -> str:
    return f"<ConditionGroup>{''.join(conditions)}</ConditionGroup>"


def _wrapped(plan: _Plan, name: str, inner: str, edge: str | None = None) -> str:
    edge = edge or plan.random.choices(("none", "rising", "falling", "risingOrFalling"), (60, 22, 8, 10))[0]
    delay = plan.number(0, 1.5, 2) if plan.chance(0.3) else 0
    return f'<Condition name="{name}" delay="{delay}" conditionEdge="{edge}">{inner}</Condition>'


def _time(plan: _Plan, name: str, value: float, rule: str) -> str:
    inner = f'<ByValueCondition><SimulationTimeCondition value="{value}" rule="{rule}"/></ByValueCondition>'
    return f'<Condition name="{name}" delay="0" conditionEdge="none">{inner}</Condition>'


def _condition(plan: _Plan, name: str) -> str:
    kinds = ("time", "state", "entity")
    kind = plan.random.choices(kinds, (35, 15, 50))[0]
    if kind == "time":
        inner = f'<SimulationTimeCondition value="{plan.number(0, 10)}" rule="{plan.one(RULES)}"/>'
        return _wrapped(plan, name, f"<ByValueCondition>{inner}</ByValueCondition>")
    if kind == "state":
        element, ref = plan.random.choice(plan.elements)
        # Of the standard's transitions, esmini has none to skip.
        states = ("completeState", "runningState", "startTransition", "endTransition", "standbyState")
        inner = f"""<StoryboardElementStateCondition storyboardElementType="{element}" storyboardElementRef="{ref}"
state="{plan.random.choices(states, (30, 25, 20, 22, 3))[0]}"/>"""
        return _wrapped(plan, name, f"<ByValueCondition>{inner}</ByValueCondition>")
    first = plan.one(plan.entities)
    triggering = [first] + ([plan.other(first)] if plan.chance(0.25) else [])
    rest = [entity for entity in plan.entities if entity not in triggering]
    inner = _of_entity(plan, plan.one(rest) if rest else plan.other(first))
    # An entity is not compared with itself.
    triggering = [entity for entity in triggering if f'entityRef="{entity}"' not in inner]
    if inner.startswith("<AccelerationCondition"):
        triggering = [entity for entity in triggering if entity in plan.steady] or [plan.one(plan.steady)]
    refs = "".join(f'<EntityRef entityRef="{entity}"/>' for entity in triggering)
    # The standard lets `all` hold where all fulfil a condition; in esmini, one entity can answer for the next in these.
    answering = inner.startswith(_ANSWERING) and len(triggering) > 1
    rule = "any" if answering else plan.one(("any", "all"))
    return _wrapped(
        plan,
        name,
        f"""<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="{rule}">{refs}</TriggeringEntities>
<EntityCondition>{inner}</EntityCondition></ByEntityCondition>""",
    )


def _of_entity(plan: _Plan, other: str) -> str:
    rule, free = f'rule="{plan.one(RULES)}"', plan.flag()
    kind = plan.random.randrange(13)
    system = f'coordinateSystem="{plan.one(("entity", "lane", "road"))}"'
    along = plan.one(("longitudinal", "lateral", "euclidianDistance"))
    measured = f'{system} relativeDistanceType="{along}" freespace="{free}"'
    if kind == 0:
        gap = f'{system} relativeDistanceType="longitudinal" freespace="{free}"'
        return f'<TimeHeadwayCondition entityRef="{other}" value="{plan.number(0.5, 4)}" {gap} {rule}/>'
    if kind == 1:
        gap = f'{system} relativeDistanceType="longitudinal" freespace="{free}"'
        target = f'<TimeToCollisionConditionTarget><EntityRef entityRef="{other}"/></TimeToCollisionConditionTarget>'
        return f'<TimeToCollisionCondition value="{plan.number(1, 8)}" {gap} {rule}>{target}</TimeToCollisionCondition>'
    if kind == 2:
        return f'<RelativeDistanceCondition entityRef="{other}" value="{plan.number(1, 40)}" {measured} {rule}/>'
    if kind == 3:
        position = f"<Position>{_lane_position(plan)}</Position>"
        return f'<DistanceCondition value="{plan.number(5, 60)}" {measured} {rule}>{position}</DistanceCondition>'
    if kind == 4:
        position = f"<Position>{_lane_position(plan)}</Position>"
        return f'<ReachPositionCondition tolerance="{plan.number(2, 8)}">{position}</ReachPositionCondition>'
    if kind == 5:
        # No sum of even steps: rounding would decide in which of two frames that is reached.
        return f'<TraveledDistanceCondition value="{plan.number(5, 120) + 0.003:.3f}"/>'
    if kind == 6 or (kind == 8 and not plan.steady):
        return f'<SpeedCondition value="{plan.number(2, 20)}" {rule}/>'
    if kind == 7:
        return f'<RelativeSpeedCondition entityRef="{other}" value="{plan.number(-5, 5)}" {rule}/>'
    if kind == 8:
        return f'<AccelerationCondition value="{plan.number(-3, 3)}" {rule}/>'
    if kind == 9:
        return f'<StandStillCondition duration="{plan.number(0.1, 1)}"/>'
    if kind == 10:
        return f'<CollisionCondition><EntityRef entityRef="{other}"/></CollisionCondition>'
    if kind == 11:
        return f'<EndOfRoadCondition duration="{plan.number(0, 1)}"/>'
    return f'<OffroadCondition duration="{plan.number(0, 1)}"/>'
