"""CarMaker, through IPG's Python module or its command port."""
