"""Study files: all scenarios that were run, and all results that were computed from these scenarios."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
