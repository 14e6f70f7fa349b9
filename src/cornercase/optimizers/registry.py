"""Optimizers by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.optimizers.base import Optimizer

# A factory takes ``space`` (ParameterSpace) and ``seed`` (int).
OPTIMIZERS: Final[Registry[Optimizer]] = Registry("optimizer", "cornercase.optimizers")
"""Optimizers by name."""

for _name, _place in (
    ("bayes", "bayes:BayesOptimizer"),
    ("evolutionary", "evolutionary:EvolutionaryOptimizer"),
    ("grid", "grid:GridOptimizer"),
    ("level-set", "level_set:LevelSetOptimizer"),
    ("optuna", "optuna_sampler:OptunaOptimizer"),
    ("random", "sequences:random"),
    ("sobol", "sequences:sobol"),
):
    OPTIMIZERS.register(_name, f"cornercase.optimizers.{_place}")
