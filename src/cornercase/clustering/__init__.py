"""Clustering of scenarios by behaviour or criticality, and analyses stored in a study."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
