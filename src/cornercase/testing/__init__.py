"""Contract checks of your own systems under test, simulators, metrics and optimizers, to run in your test suite."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
