"""CarMaker as a simulator, controlled by IPG's Python module or by its command port."""
