from . import stop as stop
from ._estimate import estimate as estimate
from ._estimation import Estimation as Estimation
from ._explore import explore as explore
from ._explorer import ExplorationResult as ExplorationResult
from ._paper_examples import examples_folder as examples_folder
from ._repair import RepairResult as RepairResult
from ._repair import repair as repair
