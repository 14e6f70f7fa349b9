from .analysis import EGO_TRAJECTORY as EGO_TRAJECTORY
from .analysis import Analysis as Analysis
from .analysis import analyze_study as analyze_study
from .estimator import ScenarioClustering as ScenarioClustering
from .profiles import Profile as Profile
from .profiles import agreements as agreements
from .search import Clustering as Clustering
from .search import cluster as cluster
