from .configuration import Exploration as Exploration
from .configuration import explore_scenario as explore_scenario
from .demonstrations import demonstration as demonstration
from .demonstrations import examples as examples
from .explorer import ExplorationResult as ExplorationResult
from .explorer import ScenarioExplorer as ScenarioExplorer
from .objective import Objective as Objective
from .objective import on_front as on_front
