"""The builtin simulator: all concrete scenarios of a batch in lock-step."""
