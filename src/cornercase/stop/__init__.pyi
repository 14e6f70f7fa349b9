from ._stop_rules import StopRule as StopRule
from ._stop_rules import audited_missed as audited_missed
from ._stop_rules import interval as interval
from ._stop_rules import missed as missed
from ._stop_rules import no_improvement as no_improvement
from ._stop_rules import overlooked as overlooked
from ._stop_rules import seconds as seconds
from ._stop_rules import unvisited as unvisited
