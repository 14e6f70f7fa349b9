"""The X-intersection with values that are set together, and an option of the ego's driver that varies in steps."""

from __future__ import annotations

from pathlib import Path

import cornercase as cc
from conftest import EXAMPLES

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
_VALUES = (("20.5", "2"), ("50", "5.25"), ("35", "4"))
_SET = (
    '<ParameterValueSet><ParameterAssignment parameterRef="ego_start" value="{}"/>'
    '<ParameterAssignment parameterRef="pedestrian_wait" value="{}"/></ParameterValueSet>'
)
_SPACE = """<OpenSCENARIO><FileHeader revMajor="1" revMinor="2" date="2026-01-01T00:00:00" author="a" description="d"/>
<ParameterValueDistribution><ScenarioFile filepath="{}"/><Deterministic>
<DeterministicMultiParameterDistribution><ValueSetDistribution>{}</ValueSetDistribution>
</DeterministicMultiParameterDistribution>
</Deterministic></ParameterValueDistribution></OpenSCENARIO>"""


def joint_values(folder: Path) -> cc.LogicalScenario:
    """Read the scenario with a space whose file is written into a folder."""
    path = folder / "joint.space.xosc"
    path.write_text(_SPACE.format(X, "".join(_SET.format(*values) for values in _VALUES)), encoding="utf-8")
    return cc.LogicalScenario.read(X, path, ["p1_speed=6:12", "Ego.reaction_time=0.5:1.5:0.25"])
