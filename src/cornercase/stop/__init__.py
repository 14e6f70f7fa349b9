"""Rules that say when an exploration ends; several rules can be combined."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
