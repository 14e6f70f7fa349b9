"""Optimizers by name."""

from cornercase.optimizers.base import OPTIMIZERS, Optimizer
from cornercase.optimizers.bayes import BayesOptimizer
from cornercase.optimizers.evolutionary import EvolutionaryOptimizer
from cornercase.optimizers.grid import GridOptimizer
from cornercase.optimizers.level_set import LevelSetOptimizer
from cornercase.optimizers.optuna_sampler import OptunaOptimizer
from cornercase.optimizers.sobol import SequenceOptimizer, random, sobol

OPTIMIZERS.register("bayes", BayesOptimizer)
OPTIMIZERS.register("evolutionary", EvolutionaryOptimizer)
OPTIMIZERS.register("grid", GridOptimizer)
OPTIMIZERS.register("level-set", LevelSetOptimizer)
OPTIMIZERS.register("optuna", OptunaOptimizer)
OPTIMIZERS.register("random", random)
OPTIMIZERS.register("sobol", sobol)

__all__ = [
    "OPTIMIZERS",
    "BayesOptimizer",
    "EvolutionaryOptimizer",
    "GridOptimizer",
    "LevelSetOptimizer",
    "Optimizer",
    "OptunaOptimizer",
    "SequenceOptimizer",
]
