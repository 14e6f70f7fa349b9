from .lane_path import LanePath as LanePath
from .notices import name_without_effect as name_without_effect
from .opendrive import RoadNetwork as RoadNetwork
from .reference_line import read_number as read_number
