"""Registry of optimizers by name."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry
from cornercase.optimizers._base import Optimizer

OPTIMIZERS: Final[Registry[Optimizer]] = Registry("optimizer", "cornercase.optimizers", Optimizer)
"""Optimizers by name.

Other packages add subclasses of `Optimizer` through the entry-point group ``cornercase.optimizers``.
"""

for _name, _target in (
    ("auto", "_auto:Auto"),
    ("bayes", "_bayes:Bayes"),
    ("committee", "_committee_search:Committee"),
    ("evolutionary", "_evolutionary:Evolutionary"),
    ("grid", "_grid:Grid"),
    ("level-set", "_level_set:LevelSet"),
    ("optuna", "_optuna:Optuna"),
    ("random", "_space_filling:Random"),
    ("sobol", "_space_filling:Sobol"),
):
    OPTIMIZERS.register(_name, f"cornercase.optimizers.{_target}")
