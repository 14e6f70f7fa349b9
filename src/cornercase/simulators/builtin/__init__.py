"""The builtin simulator, which runs all concrete scenarios of a batch at the same time."""
