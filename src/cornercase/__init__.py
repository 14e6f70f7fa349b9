"""Find, cluster and reduce the critical concrete scenarios of a logical scenario."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from cornercase.analysis import analyze_study
    from cornercase.critical_set import CriticalSet
    from cornercase.drivers import DRIVERS
    from cornercase.errors import InputError, SimulationError
    from cornercase.estimator import ScenarioClustering
    from cornercase.explorer import ScenarioExplorer
    from cornercase.metrics import METRICS
    from cornercase.optimizers import OPTIMIZERS
    from cornercase.recording import Recording, read_recording
    from cornercase.reduction import reduce_study
    from cornercase.report import write_report
    from cornercase.scenario.logical import ConcreteScenario, LogicalScenario
    from cornercase.scenario.space import ParameterSpace
    from cornercase.simulators import SIMULATORS
    from cornercase.simulators.builtin import BuiltinSimulator
    from cornercase.study import Study

# Loaded on first use, so that running one scenario does not wait for what clustering and drawing need.
_HOMES = {
    "DRIVERS": "drivers",
    "METRICS": "metrics",
    "OPTIMIZERS": "optimizers",
    "SIMULATORS": "simulators",
    "BuiltinSimulator": "simulators.builtin",
    "ConcreteScenario": "scenario.logical",
    "CriticalSet": "critical_set",
    "InputError": "errors",
    "LogicalScenario": "scenario.logical",
    "ParameterSpace": "scenario.space",
    "Recording": "recording",
    "ScenarioClustering": "estimator",
    "ScenarioExplorer": "explorer",
    "SimulationError": "errors",
    "Study": "study",
    "analyze_study": "analysis",
    "read_recording": "recording",
    "reduce_study": "reduction",
    "write_report": "report",
}

__all__ = [
    "DRIVERS",
    "METRICS",
    "OPTIMIZERS",
    "SIMULATORS",
    "BuiltinSimulator",
    "ConcreteScenario",
    "CriticalSet",
    "InputError",
    "LogicalScenario",
    "ParameterSpace",
    "Recording",
    "ScenarioClustering",
    "ScenarioExplorer",
    "SimulationError",
    "Study",
    "analyze_study",
    "read_recording",
    "reduce_study",
    "write_report",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'cornercase' has no attribute '{name}'")
    return getattr(import_module(f"cornercase.{_HOMES[name]}"), name)
