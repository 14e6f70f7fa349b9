"""Run a suite (a few selected scenarios) again: verdicts, requirements, and what has changed."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
