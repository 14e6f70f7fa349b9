from ._page import write_report as write_report
from ._summary import FailureSummary as FailureSummary
from ._summary import MetricSummary as MetricSummary
from ._summary import Summary as Summary
from ._summary import summarize as summarize
from .comparison._comparison_page import write_comparison as write_comparison
from .live._watch import watch as watch
from .replays._replay import replay as replay
