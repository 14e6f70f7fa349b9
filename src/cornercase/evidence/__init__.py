"""Estimates of critical sets, probabilities and sensitivities, by Gaussian processes and importance sampling."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
