from .direction import RoadTables as RoadTables
from .direction import road_heading as road_heading
from .direction import road_tables as road_tables
from .lane_path import KINK as KINK
from .lane_path import LanePath as LanePath
from .notices import name_without_effect as name_without_effect
from .opendrive import RoadNetwork as RoadNetwork
from .reference_line import read_number as read_number
