"""Whatever stands in an attribute, a scenario runs, or one sentence says why it does not."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from lxml import etree

from conftest import ROAD, car, examples
from cornercase._common.errors import InputError, SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import Builtin

# What junk is read as is said; here it only has to run, or to be refused.
pytestmark = pytest.mark.filterwarnings("ignore::cornercase._common.errors.NoticeWarning")

JUNK = ("", "nan", "1e999", "-1", "0", "x", "${", "${1/0}", "$nope", "$v", "9" * 400, "1e9", "-1e300", "true", "0.5")


def world(x: str) -> str:
    return f'<Position><WorldPosition x="{x}" y="0" h="0"/></Position>'


def lane(s: str, number: str = "-1") -> str:
    orientation = '<Orientation type="relative" h="0"/>'
    return f'<Position><LanePosition roadId="1" laneId="{number}" s="{s}" offset="0">{orientation}</LanePosition></Position>'


DYNAMICS = 'dynamicsShape="linear" dynamicsDimension="time" value="1" followingMode="position"'
LIMITS = '<DynamicConstraints maxAcceleration="3" maxDeceleration="5" maxSpeed="30" maxAccelerationRate="4" maxDecelerationRate="4"/>'
ROUTE = f'<Route name="r" closed="false"><Waypoint routeStrategy="shortest">{lane("10")}</Waypoint><Waypoint routeStrategy="shortest">{lane("400")}</Waypoint></Route>'
TIMED = '<TimeReference><Timing domainAbsoluteRelative="relative" scale="1" offset="0"/></TimeReference>'
SHAPES = (
    f'<Polyline><Vertex time="0">{world("50")}</Vertex><Vertex time="2">{world("70")}</Vertex></Polyline>',
    f'<Clothoid curvature="0.01" curvaturePrime="0.001" length="30" startTime="0" stopTime="3">{world("50")}</Clothoid>',
    '<ClothoidSpline timeEnd="3"><ClothoidSplineSegment curvatureStart="0" curvatureEnd="0.01" length="20">'
    '<PositionStart><WorldPosition x="50" y="0" h="0"/></PositionStart></ClothoidSplineSegment></ClothoidSpline>',
    '<Nurbs order="3">' + "".join(f'<ControlPoint time="{k}" weight="1">{world(str(50 + 9 * k))}</ControlPoint>' for k in range(4))
    + "".join(f'<Knot value="{k}"/>' for k in (0, 0, 0, 1, 2, 2, 2)) + "</Nurbs>",
)  # fmt: skip
FOLLOW = [
    f'<RoutingAction><FollowTrajectoryAction initialDistanceOffset="1"><TrajectoryRef><Trajectory name="t" closed="false"><ParameterDeclarations/>'
    f'<Shape>{shape}</Shape></Trajectory></TrajectoryRef>{TIMED}<TrajectoryFollowingMode followingMode="follow"/></FollowTrajectoryAction></RoutingAction>'
    for shape in SHAPES
]
PRIVATE = [
    *FOLLOW,
    f'<LongitudinalAction><SpeedAction><SpeedActionDynamics {DYNAMICS}/><SpeedActionTarget><AbsoluteTargetSpeed value="9"/></SpeedActionTarget></SpeedAction></LongitudinalAction>',
    f'<LongitudinalAction><SpeedAction><SpeedActionDynamics {DYNAMICS}/><SpeedActionTarget><RelativeTargetSpeed entityRef="Other" value="1" speedTargetValueType="delta" continuous="false"/></SpeedActionTarget></SpeedAction></LongitudinalAction>',
    f'<LongitudinalAction><SpeedProfileAction entityRef="Other" followingMode="follow">{LIMITS}<SpeedProfileEntry time="1" speed="5"/><SpeedProfileEntry time="1" speed="8"/></SpeedProfileAction></LongitudinalAction>',
    f'<LongitudinalAction><LongitudinalDistanceAction entityRef="Other" distance="20" freespace="true" continuous="true" coordinateSystem="entity" displacement="any">{LIMITS}</LongitudinalDistanceAction></LongitudinalAction>',
    f'<LongitudinalAction><LongitudinalDistanceAction entityRef="Other" timeGap="2" freespace="false" continuous="false" coordinateSystem="lane">{LIMITS}</LongitudinalDistanceAction></LongitudinalAction>',
    f'<LateralAction><LaneChangeAction targetLaneOffset="0.1"><LaneChangeActionDynamics {DYNAMICS}/><LaneChangeTarget><AbsoluteTargetLane value="1"/></LaneChangeTarget></LaneChangeAction></LateralAction>',
    f'<LateralAction><LaneChangeAction><LaneChangeActionDynamics {DYNAMICS}/><LaneChangeTarget><RelativeTargetLane entityRef="Other" value="1"/></LaneChangeTarget></LaneChangeAction></LateralAction>',
    '<LateralAction><LaneOffsetAction continuous="false"><LaneOffsetActionDynamics dynamicsShape="cubic" maxLateralAcc="2"/><LaneOffsetTarget><AbsoluteTargetLaneOffset value="1"/></LaneOffsetTarget></LaneOffsetAction></LateralAction>',
    f'<LateralAction><LateralDistanceAction entityRef="Other" distance="2" freespace="true" continuous="true" coordinateSystem="entity" displacement="any">{LIMITS}</LateralDistanceAction></LateralAction>',
    f"<RoutingAction><AssignRouteAction>{ROUTE}</AssignRouteAction></RoutingAction>",
    f"<RoutingAction><AcquirePositionAction>{lane('300')}</AcquirePositionAction></RoutingAction>",
    '<SynchronizeAction masterEntityRef="Other" targetTolerance="1" targetToleranceMaster="1"><TargetPositionMaster><LanePosition roadId="1" laneId="-1" s="200"/></TargetPositionMaster><TargetPosition><LanePosition roadId="1" laneId="-1" s="150"/></TargetPosition><FinalSpeed><AbsoluteSpeed value="9"><SteadyState/></AbsoluteSpeed></FinalSpeed></SynchronizeAction>',
    '<VisibilityAction graphics="true" traffic="false" sensors="true"/>',
    f"<TeleportAction><Position><RoutePosition><RouteRef>{ROUTE}</RouteRef><InRoutePosition><FromLaneCoordinates pathS='5' laneId='-1' laneOffset='0'/></InRoutePosition></RoutePosition></Position></TeleportAction>",
    '<TeleportAction><Position><RoadPosition roadId="1" s="30" t="-2"/></Position></TeleportAction>',
    '<TeleportAction><Position><RelativeLanePosition entityRef="Other" dLane="0" ds="5" offset="0"/></Position></TeleportAction>',
    '<TeleportAction><Position><RelativeRoadPosition entityRef="Other" ds="5" dt="0"/></Position></TeleportAction>',
    '<TeleportAction><Position><RelativeObjectPosition entityRef="Other" dx="5" dy="0"/></Position></TeleportAction>',
    '<TeleportAction><Position><RelativeWorldPosition entityRef="Other" dx="5" dy="0"/></Position></TeleportAction>',
]  # fmt: skip
BY_ENTITY = [
    '<TraveledDistanceCondition value="1"/>',
    f'<ReachPositionCondition tolerance="2">{lane("60")}</ReachPositionCondition>',
    '<SpeedCondition value="5" rule="greaterThan" direction="longitudinal"/>',
    '<RelativeSpeedCondition entityRef="Other" value="5" rule="greaterThan" direction="lateral"/>',
    '<AccelerationCondition value="5" rule="lessThan" direction="lateral"/>',
    '<StandStillCondition duration="0.1"/>', '<EndOfRoadCondition duration="0.1"/>', '<OffroadCondition duration="0.1"/>',
    '<CollisionCondition><EntityRef entityRef="Other"/></CollisionCondition>',
    '<CollisionCondition><ByType type="vehicle"/></CollisionCondition>',
    '<RelativeDistanceCondition entityRef="Other" relativeDistanceType="longitudinal" value="9" freespace="true" rule="lessThan" coordinateSystem="lane"/>',
    f'<DistanceCondition value="9" freespace="true" rule="lessThan" coordinateSystem="lane" relativeDistanceType="longitudinal">{lane("60")}</DistanceCondition>',
    '<TimeHeadwayCondition entityRef="Other" value="2" freespace="true" rule="lessThan" coordinateSystem="lane" relativeDistanceType="longitudinal"/>',
    '<TimeToCollisionCondition value="2" freespace="true" rule="lessThan" coordinateSystem="lane" relativeDistanceType="longitudinal"><TimeToCollisionConditionTarget><EntityRef entityRef="Other"/></TimeToCollisionConditionTarget></TimeToCollisionCondition>',
    '<RelativeClearanceCondition distanceForward="9" distanceBackward="9" freeSpace="true" oppositeLanes="true"><RelativeLaneRange from="-1" to="1"/></RelativeClearanceCondition>',
]  # fmt: skip
BY_VALUE = [
    '<SimulationTimeCondition value="0.1" rule="greaterThan"/>', '<ParameterCondition parameterRef="v" value="1" rule="greaterThan"/>',
    '<ParameterCondition parameterRef="word" value="a" rule="equalTo"/>', '<VariableCondition variableRef="count" value="1" rule="equalTo"/>',
    '<StoryboardElementStateCondition storyboardElementType="event" storyboardElementRef="e0" state="completeState"/>',
    '<TrafficSignalCondition name="a" state="green"/>',
]  # fmt: skip
GLOBAL = [
    '<VariableAction variableRef="count"><ModifyAction><Rule><AddValue value="1"/></Rule></ModifyAction></VariableAction>',
    '<InfrastructureAction><TrafficSignalAction><TrafficSignalStateAction name="a" state="green"/></TrafficSignalAction></InfrastructureAction>',
    f'<EntityAction entityRef="Other"><AddEntityAction>{lane("90")}</AddEntityAction></EntityAction>',
]


def event(k: int, action: str, condition: str) -> str:
    return f"""<Event name="e{k}" priority="parallel" maximumExecutionCount="2">{action}<StartTrigger><ConditionGroup>
<Condition name="c" delay="0.05" conditionEdge="none">{condition}</Condition></ConditionGroup></StartTrigger></Event>"""


def file_of_all() -> bytes:
    """A scenario with all actions, conditions and positions."""
    conditions = [
        f'<ByEntityCondition><TriggeringEntities triggeringEntitiesRule="any"><EntityRef entityRef="Ego"/></TriggeringEntities>'
        f"<EntityCondition>{one}</EntityCondition></ByEntityCondition>"
        for one in BY_ENTITY
    ] + [f"<ByValueCondition>{one}</ByValueCondition>" for one in BY_VALUE]
    actions = [f"<PrivateAction>{one}</PrivateAction>" for one in PRIVATE] + [
        f"<GlobalAction>{one}</GlobalAction>" for one in GLOBAL
    ]
    always = '<ByValueCondition><SimulationTimeCondition value="0" rule="greaterOrEqual"/></ByValueCondition>'
    events = [event(k, f'<Action name="a{k}">{action}</Action>', always) for k, action in enumerate(actions)]
    idle = f'<Action name="a">{actions[4]}</Action>'
    events += [event(100 + k, idle, condition) for k, condition in enumerate(conditions)]
    speed = '<PrivateAction><LongitudinalAction><SpeedAction><SpeedActionDynamics dynamicsShape="step" dynamicsDimension="time" value="0"/><SpeedActionTarget><AbsoluteTargetSpeed value="$v"/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>'
    init = "".join(
        f'<Private entityRef="{name}"><PrivateAction><TeleportAction>{lane(s)}</TeleportAction></PrivateAction>{speed}</Private>'
        for name, s in (("Ego", "50"), ("Other", "80"))
    )
    groups = "".join(
        f'<ManeuverGroup name="g{k}" maximumExecutionCount="1"><Actors selectTriggeringEntities="false"><EntityRef entityRef="Ego"/></Actors>'
        f'<Maneuver name="m{k}">{one}</Maneuver></ManeuverGroup>'
        for k, one in enumerate(events)
    )
    return f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="3" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterDeclarations><ParameterDeclaration name="v" parameterType="double" value="10"><ConstraintGroup><ValueConstraint rule="lessThan" value="99"/>
</ConstraintGroup></ParameterDeclaration><ParameterDeclaration name="word" parameterType="string" value="a"/>
<ParameterDeclaration name="number" parameterType="integer" value="3"/><ParameterDeclaration name="truth" parameterType="boolean" value="true"/>
</ParameterDeclarations><VariableDeclarations><VariableDeclaration name="count" variableType="integer" value="0"/></VariableDeclarations>
<CatalogLocations><VehicleCatalog><Directory path="nowhere"/></VehicleCatalog></CatalogLocations>
<RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>{car("Ego")}{car("Other")}
<EntitySelection name="both"><Members><EntityRef entityRef="Ego"/><ByType objectType="vehicle"/></Members></EntitySelection></Entities>
<Storyboard><Init><Actions>{init}</Actions></Init><Story name="s"><Act name="act">{groups}<StartTrigger/></Act></Story>
<StopTrigger/></Storyboard></OpenSCENARIO>""".encode()


WHOLE = file_of_all()
PLACES = [
    (k, name)
    for k, element in enumerate(etree.fromstring(WHOLE).iter())
    for name in element.attrib
    if element.tag not in ("FileHeader",)
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("junk")
    (folder / "road.xodr").write_text(ROAD)
    return folder


def result_of(folder, content: bytes) -> object:
    path = folder / "scenario.xosc"
    path.write_bytes(content)
    try:
        (found,) = Builtin(duration=0.5).run([ConcreteScenario(path, {}, ScenarioFile.read(path))])
    except InputError as error:
        return error
    return found


def changed(place: int, value: str) -> bytes:
    root = etree.fromstring(WHOLE)
    k, name = PLACES[place]
    list(root.iter())[k].set(name, value)
    return etree.tostring(root)


def test_the_file_with_everything_runs(folder):
    assert isinstance(result_of(folder, WHOLE), Recording)


@settings(max_examples=examples(150), deadline=None)
@given(st.integers(0, len(PLACES) - 1), st.sampled_from(JUNK) | st.text(max_size=8, alphabet="aN1.-+e$*{}()/ ∞é"))
def test_any_attribute_may_be_junk(folder, place, value):
    found = result_of(folder, changed(place, value))
    assert isinstance(found, Recording | SimulationError | InputError)
    if isinstance(found, Exception):
        assert 0 < len(str(found)) < 1000
        assert "\n" not in str(found)


if __name__ == "__main__":
    # Every attribute with every piece of junk, which takes minutes.
    import sys
    from pathlib import Path
    from tempfile import TemporaryDirectory

    with TemporaryDirectory() as name:
        (Path(name) / "road.xodr").write_text(ROAD)
        for place in range(len(PLACES)):
            for value in JUNK:
                try:
                    result_of(Path(name), changed(place, value))
                except Exception as error:
                    k, attribute = PLACES[place]
                    element = list(etree.fromstring(WHOLE).iter())[k]
                    sys.stdout.write(f"{element.sourceline} {attribute!r}={value[:20]!r}: {error!r}\n")
