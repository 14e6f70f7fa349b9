"""Run suites (sets of concrete scenarios), judge them by requirements, and compare versions of the tested system."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
