"""The report: one page that a person reads by looking."""

from cornercase.report.page import write_report

__all__ = ["write_report"]
