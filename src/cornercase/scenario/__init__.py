"""What is tested: OpenSCENARIO files, logical and concrete scenarios, and the space of their parameters."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
