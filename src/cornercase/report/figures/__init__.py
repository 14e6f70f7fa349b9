"""Figures of the report, drawn without any display."""
