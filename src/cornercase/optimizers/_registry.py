"""Optimizers by name."""

from __future__ import annotations

from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.registry import Registry
from cornercase.metrics import registered_features
from cornercase.optimizers._base import Optimizer, OptimizerInput
from cornercase.scenario import ParameterSpace

OPTIMIZERS: Final[Registry[Optimizer]] = Registry("optimizer", "cornercase.optimizers", Optimizer)
"""Optimizers by name; other packages add subclasses of `Optimizer` through this entry-point group."""

for _name, _target in (
    ("bayes", "_bayes:BayesOptimizer"),
    ("committee", "_committee_search:CommitteeOptimizer"),
    ("evolutionary", "_evolutionary:EvolutionaryOptimizer"),
    ("grid", "_grid:GridOptimizer"),
    ("level-set", "_level_set:LevelSetOptimizer"),
    ("optuna", "_optuna:OptunaOptimizer"),
    ("random", "_qmc:RandomOptimizer"),
    ("sobol", "_qmc:SobolOptimizer"),
):
    OPTIMIZERS.register(_name, f"cornercase.optimizers.{_target}")


def optimizer_requirements(name: str) -> frozenset[OptimizerInput]:
    """Arguments that an optimizer requires besides space and seed. InputError if there is no such optimizer."""
    return OPTIMIZERS.get_class(name).requires


def create_optimizer(name: str, space: ParameterSpace, seed: int, *, threshold: float | None, budget: int) -> Optimizer:
    """Create an optimizer with the arguments that it requires.

    Parameters
    ----------
    name : str
        Options may follow a colon: ``"bayes:filling=0"``.
    space : ParameterSpace
    seed : int
    threshold : float or None
        Score up to which a scenario is critical, with lower as more critical; None if it is not known.
    budget : int
        Total number of scenarios.

    Returns
    -------
    Optimizer

    Raises
    ------
    InputError
        There is no such optimizer or option, or the optimizer requires a threshold and there is none.
    """
    options: dict[str, Any] = {}
    needs = optimizer_requirements(name)
    if "threshold" in needs:
        if threshold is None:
            raise InputError(f"The optimizer '{name}' needs a threshold; give one with `critical`.")
        options["threshold"] = threshold
    if "budget" in needs:
        options["budget"] = budget
    if "features" in needs:
        options["features"] = registered_features()
    return OPTIMIZERS.create(name, space=space, seed=seed, **options)
