"""HTML of the report page: its detail sections, tables, links and templates."""
