"""Details of the report in tables, one module for each stage."""
