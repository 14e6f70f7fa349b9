"""Values of all parameters of a concrete scenario, by name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from cornercase.scenario.constraints import read_declarations
from cornercase.scenario.declared_types import typed_value
from cornercase.scenario.openscenario import Scenario
from cornercase.scenario.parameter import Value
from cornercase.scenario.scope import Scope


def named_values(scenario: Scenario, given: Mapping[str, Value]) -> dict[str, Value]:
    """Give the values of all parameters of a scenario: those given, else those of the file, with expressions evaluated.

    Each has its declared type. What is given for a parameter that the file does not declare stays as it is.
    """
    declarations = {one.name: one for one in read_declarations(scenario.root, str(scenario.path))}
    # What is given as the file has it is the file's own.
    own = {name: one for name, one in given.items() if name in declarations and one != declarations[name].value}
    scope = Scope.of_declarations(str(scenario.path), list(declarations.values()), [own])
    found = {name: _plain(scope.values[name], one.kind) for name, one in declarations.items()}
    return found | {name: one for name, one in given.items() if name not in declarations}


def _plain(value: Any, kind: str) -> Value:
    plain = value.flat[0].item() if isinstance(value, np.ndarray) else value
    try:
        return typed_value(plain, kind)
    except ValueError:
        # A declaration may be there for other tools only.
        return str(plain)
