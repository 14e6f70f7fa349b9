"""Figures of the report, drawn without a display."""
