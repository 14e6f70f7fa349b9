from ._rules import StopRule as StopRule
from ._rules import audited_missed as audited_missed
from ._rules import interval as interval
from ._rules import missed as missed
from ._rules import no_improvement as no_improvement
from ._rules import overlooked as overlooked
from ._rules import seconds as seconds
from ._rules import unvisited as unvisited
