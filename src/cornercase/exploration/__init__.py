"""The loop of the paper's figure: from a logical scenario to a study."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
