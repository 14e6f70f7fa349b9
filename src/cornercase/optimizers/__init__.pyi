from .base import Optimizer as Optimizer
from .bayes import BayesOptimizer as BayesOptimizer
from .evolutionary import EvolutionaryOptimizer as EvolutionaryOptimizer
from .grid import GridOptimizer as GridOptimizer
from .level_set import LevelSetOptimizer as LevelSetOptimizer
from .optuna_sampler import OptunaOptimizer as OptunaOptimizer
from .registry import OPTIMIZERS as OPTIMIZERS
from .sequences import SequenceOptimizer as SequenceOptimizer
