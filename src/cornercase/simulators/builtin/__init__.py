"""The builtin simulator: all concrete scenarios of a batch at once."""
