"""List of all simulators, functions that run scenarios, and the base class for your own simulators."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
