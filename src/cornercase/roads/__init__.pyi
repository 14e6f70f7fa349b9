from .lane_path import LanePath as LanePath
from .opendrive import RoadNetwork as RoadNetwork
