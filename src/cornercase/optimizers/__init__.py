"""Optimizers, which propose the scenarios to run; their registry, and the base class for your own optimizers."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
