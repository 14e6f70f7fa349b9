"""Logical and concrete scenarios."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from cornercase.scenario.space import ParameterSpace, Value


@dataclass(frozen=True)
class ConcreteScenario:
    """One traffic situation, ready to run.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    values : mapping of str to float or str
        Parameters that differ from the file's own.
    """

    path: Path
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class LogicalScenario:
    """A traffic situation with parameter ranges.

    Attributes
    ----------
    path : Path
        OpenSCENARIO file.
    space : ParameterSpace
        What is varied, and in which bounds.
    """

    path: Path
    space: ParameterSpace

    def concrete(self, values: Mapping[str, Value]) -> ConcreteScenario:
        """Return the concrete scenario of the given values."""
        return ConcreteScenario(self.path, dict(values))
