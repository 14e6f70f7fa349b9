"""Optimizers by name."""

from __future__ import annotations

from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.registry import Registry
from cornercase.metrics import known_features
from cornercase.optimizers.base import Need, Optimizer
from cornercase.scenario import ParameterSpace

OPTIMIZERS: Final[Registry[Optimizer]] = Registry("optimizer", "cornercase.optimizers", Optimizer)
"""Optimizers by name; other packages add subclasses of `Optimizer` through this entry-point group."""

for _name, _place in (
    ("bayes", "bayes:BayesOptimizer"),
    ("committee", "committee:CommitteeOptimizer"),
    ("evolutionary", "evolutionary:EvolutionaryOptimizer"),
    ("grid", "grid:GridOptimizer"),
    ("level-set", "level_set:LevelSetOptimizer"),
    ("optuna", "optuna_sampler:OptunaOptimizer"),
    ("random", "sequences:RandomOptimizer"),
    ("sobol", "sequences:SobolOptimizer"),
):
    OPTIMIZERS.register(_name, f"cornercase.optimizers.{_place}")


def optimizer_needs(name: str) -> frozenset[Need]:
    """What an optimizer needs beside the space and the seed, as it declares.

    Parameters
    ----------
    name : str
        As for `create_optimizer`.

    Returns
    -------
    frozenset of {"threshold", "budget", "features"}

    Raises
    ------
    InputError
        There is no optimizer of this name, or it is no subclass of `Optimizer`.
    """
    return OPTIMIZERS.class_of(name).needs


def create_optimizer(name: str, space: ParameterSpace, seed: int, *, threshold: float | None, budget: int) -> Optimizer:
    """Build an optimizer with what it needs.

    Parameters
    ----------
    name : str
        Options may stand after a colon: ``"bayes:filling=0"``.
    space : ParameterSpace
    seed : int
    threshold : float or None
        Oriented score up to which a scenario is critical; None where it is not known.
    budget : int
        Scenarios in all.

    Returns
    -------
    Optimizer

    Raises
    ------
    InputError
        There is no such optimizer or option, or the optimizer needs a threshold and there is none.
    """
    options: dict[str, Any] = {}
    needs = optimizer_needs(name)
    if "threshold" in needs:
        if threshold is None:
            raise InputError(f"The optimizer '{name}' needs a threshold; give one with `critical`.")
        options["threshold"] = threshold
    if "budget" in needs:
        options["budget"] = budget
    if "features" in needs:
        options["features"] = known_features()
    return OPTIMIZERS.create(name, space=space, seed=seed, **options)
