from .page import write_report as write_report
from .summary import summarize as summarize
