"""Objects of the public API: studies, suites, comparisons and HTML pages."""

import lazy_loader as lazy

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)
