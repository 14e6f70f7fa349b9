"""CarMaker by IPG's Python module or its command port."""
