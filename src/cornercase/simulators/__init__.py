"""Simulators by name."""

from cornercase.simulators.base import SIMULATORS, Simulator
from cornercase.simulators.builtin import BuiltinSimulator

SIMULATORS.register("builtin", BuiltinSimulator)

__all__ = ["SIMULATORS", "BuiltinSimulator", "Simulator"]
