"""Store everything that was run, and everything that was computed from it, in a study file."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
