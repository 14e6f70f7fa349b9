"""Presentation of studies: reports, replays, comparisons, and a live page."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
