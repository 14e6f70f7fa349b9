"""Reduction: select the few concrete scenarios that represent all that were run."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
