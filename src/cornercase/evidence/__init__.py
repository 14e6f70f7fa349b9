"""What is known of what was not run: the Gaussian process, the critical set, the influence of parameters."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
