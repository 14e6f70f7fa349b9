from .page import write_report as write_report
from .summary import MetricSummary as MetricSummary
from .summary import Summary as Summary
from .summary import summarize as summarize
from .words import put_in_words as put_in_words
