"""Exploration: search a logical scenario for critical concrete scenarios, in a loop of proposals and simulations."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
