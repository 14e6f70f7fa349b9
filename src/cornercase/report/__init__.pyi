from .live.watching import watch as watch
from .page import write_report as write_report
from .plain import put_in_words as put_in_words
from .replays.writing import replay as replay
from .summary import MetricSummary as MetricSummary
from .summary import Summary as Summary
from .summary import summarize as summarize
from .versions.page import write_comparison as write_comparison
