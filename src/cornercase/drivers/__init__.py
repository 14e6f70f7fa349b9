"""Drivers, sensors and vehicle models by name, and base classes for your own."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
