"""Distances between scenarios by dynamic time warping (DTW) of their time series."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
