from __future__ import annotations

# ruff: noqa: E402 - what is set here is read once, when NumPy is imported
import gc
import os
import signal
from collections.abc import Container, Iterable, Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import NoReturn

# Threads of linear algebra wait for each other in a loop, which took a third of all time on two busy processors.
for _library in ("OPENBLAS", "OMP"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# Thousands of tests stay until the end: looking through them for garbage again and again took a third of collecting them.
gc.disable()

import functools

import numpy as np
import pytest
import typer.main

from cornercase import SimulationError
from cornercase.recordings import Recording
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.simulators import Builtin, Simulator
from helpers.cpu_times import Summary, pytest_addoption, pytest_runtest_protocol, pytest_sessionfinish
from helpers.ready_workers import fork_workers, spawn_workers

# Typer makes all commands again for each that is run, which takes longer than many of them.
typer.main.get_command = functools.cache(typer.main.get_command)

__all__ = ["pytest_addoption", "pytest_runtest_protocol", "pytest_sessionfinish"]

EXAMPLES = Path(__file__).parents[1] / "examples"


# Whether those that are marked slow are left out.
_by_day = False


def pytest_configure(config: pytest.Config) -> None:
    global _by_day
    _by_day = "not slow" in config.getoption("markexpr")
    if config.getoption("--cpu-times") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(Summary())


def pytest_collection_finish() -> None:
    # What is there by now is nobody's garbage.
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def interrupts() -> Iterator[None]:
    """Interrupts arrive in tests too where a shell ran them in the background, which ignores the signal."""
    before = signal.getsignal(signal.SIGINT)
    if before == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.fixture(scope="session", autouse=True)
def cache_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Tests neither use nor fill the caches of whoever runs them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="session", autouse=True)
def forked_workers() -> Iterator[None]:
    """By day worker processes are forked from one that has imported everything; at night they are spawned."""
    with fork_workers() if _by_day else nullcontext():
        yield


@pytest.fixture
def spawned_workers() -> Iterator[None]:
    """Workers start as those of users do, by day too."""
    with spawn_workers():
        yield


@pytest.fixture
def no_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing of what other tests have run is remembered."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "no-cache"))


def without(what: str) -> NoReturn:
    """Skip what needs something that is not there; in CI, where it has to be, that is a failure."""
    if os.environ.get("CI", "").lower() in ("", "0", "false"):
        pytest.skip(what)
    pytest.fail(f"{what}; in CI it has to be there", pytrace=False)


def at_night(values: Iterable[object], rest: Container[object]) -> list[object]:
    """Parameters of a test, of which the rest is left to `make test-all`."""
    return [pytest.param(one, marks=pytest.mark.slow) if one in rest else one for one in values]


def examples(count: int) -> int:
    """How many examples a property is tried with: an eighth of them by day, but not next to none."""
    return max(count // 8, min(count, 10)) if _by_day else count


def example(name: str) -> LogicalScenario:
    return LogicalScenario.read(EXAMPLES / name / f"{name}.xosc", EXAMPLES / name / f"{name}.space.xosc")


@pytest.fixture(scope="session")
def x_intersection() -> LogicalScenario:
    return example("x_intersection")


@pytest.fixture(scope="session")
def t_intersection() -> LogicalScenario:
    return example("t_intersection")


def ran(simulator: Simulator, concretes: Iterable[ConcreteScenario]) -> list[Recording]:
    """Recordings of scenarios none of which may fail."""
    recordings = []
    for result in simulator.run(list(concretes)):
        if isinstance(result, SimulationError):
            raise result
        recordings.append(result)
    return recordings


def same_recording(a, b) -> bool:
    return (
        a.names == b.names
        and a.collisions == b.collisions
        and all(
            np.array_equal(getattr(a, key), getattr(b, key), equal_nan=True)
            for key in ("time", "x", "y", "heading", "speed", "acceleration", "length", "width", "center_x")
        )
    )


@pytest.fixture(scope="session")
def builtin() -> Builtin:
    return Builtin()


# A straight road and one car or two; what the tests put in is the storyboard.
ROAD = """<OpenDRIVE><header revMajor="1" revMinor="7"/><road id="1" length="500" junction="-1">
<planView><geometry s="0" x="0" y="0" hdg="0" length="500"><line/></geometry></planView>
<lanes><laneSection s="0"><left><lane id="1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></left>
<center><lane id="0" type="none"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right>
</laneSection></lanes></road></OpenDRIVE>"""


AXLES = "".join(
    f'<{kind} maxSteering="0.5" wheelDiameter="0.6" trackWidth="1.6" positionX="{x}" positionZ="0.3"/>'
    for kind, x in (("FrontAxle", 2.7), ("RearAxle", 0))
)


def car(name: str) -> str:
    return f"""<ScenarioObject name="{name}"><Vehicle name="car" vehicleCategory="car">
<BoundingBox><Center x="1.4" y="0" z="0.7"/><Dimensions length="4" width="2" height="1.5"/></BoundingBox>
<Performance maxSpeed="60" maxAcceleration="200" maxDeceleration="200"/><Axles>{AXLES}</Axles><Properties/></Vehicle></ScenarioObject>"""


def speed_action(value: str, shape: str = "step", dimension: str = "time", over: str = "0") -> str:
    return f"""<PrivateAction><LongitudinalAction><SpeedAction>
<SpeedActionDynamics dynamicsShape="{shape}" dynamicsDimension="{dimension}" value="{over}"/>
<SpeedActionTarget><AbsoluteTargetSpeed value="{value}"/></SpeedActionTarget></SpeedAction></LongitudinalAction></PrivateAction>"""


def teleport(s: str, lane: str = "-1") -> str:
    return f"""<PrivateAction><TeleportAction><Position><LanePosition roadId="1" laneId="{lane}" s="{s}"/></Position>
</TeleportAction></PrivateAction>"""


def scenario_file(
    folder: Path,
    *,
    init: str,
    story: str = "",
    stop: str = "",
    parameters: str = "",
    entities: str = car("Ego"),
    name: str = "scenario.xosc",
) -> Path:
    (folder / "road.xodr").write_text(ROAD)
    path = folder / name
    path.write_text(f"""<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a"
description="d"/><ParameterDeclarations>{parameters}</ParameterDeclarations><CatalogLocations/>
<RoadNetwork><LogicFile filepath="road.xodr"/></RoadNetwork><Entities>{entities}</Entities>
<Storyboard><Init><Actions>{init}</Actions></Init>{story}<StopTrigger>{stop}</StopTrigger></Storyboard></OpenSCENARIO>""")
    return path


def time_trigger(value: str, rule: str = "greaterOrEqual", edge: str = "none", delay: str = "0") -> str:
    return f"""<ConditionGroup><Condition name="c" delay="{delay}" conditionEdge="{edge}"><ByValueCondition>
<SimulationTimeCondition value="{value}" rule="{rule}"/></ByValueCondition></Condition></ConditionGroup>"""


def story_of(events: str, actor: str = "Ego") -> str:
    return f"""<Story name="s"><Act name="a"><ManeuverGroup name="g" maximumExecutionCount="1">
<Actors selectTriggeringEntities="false"><EntityRef entityRef="{actor}"/></Actors><Maneuver name="m">{events}</Maneuver>
</ManeuverGroup><StartTrigger>{time_trigger("0")}</StartTrigger></Act></Story>"""


def event(name: str, action: str, trigger: str, priority: str = "parallel") -> str:
    return f"""<Event name="{name}" priority="{priority}" maximumExecutionCount="1"><Action name="{name}-action">{action}
</Action><StartTrigger>{trigger}</StartTrigger></Event>"""


def private(entity, *actions):
    return f'<Private entityRef="{entity}">{"".join(actions)}</Private>'


def moving(s="50", speed="10", entity="Ego", lane="-1"):
    return private(entity, teleport(s, lane), speed_action(speed))


def run(path, duration=10.0, **values):
    (result,) = Builtin(duration=duration).run([ConcreteScenario(path, values)])
    assert not isinstance(result, Exception), result
    return result


def trajectory(shape, reference="<None/>", mode="position", closed="false"):
    return f"""<PrivateAction><RoutingAction><FollowTrajectoryAction><TrajectoryRef><Trajectory name="t" closed="{closed}">
<Shape>{shape}</Shape></Trajectory></TrajectoryRef><TimeReference>{reference}</TimeReference><TrajectoryFollowingMode
followingMode="{mode}"/></FollowTrajectoryAction></RoutingAction></PrivateAction>"""


def place(x, y, more=""):
    return f'<Position><WorldPosition x="{x}" y="{y}" {more}/></Position>'
