"""Detail sections of the report, one module for each stage of the work."""
