"""Find, cluster and reduce the critical concrete scenarios of a logical scenario."""

import lazy_loader as lazy

from cornercase._common.displays import DISPLAYS as _DISPLAYS
from cornercase._common.version import __version__ as __version__

__getattr__, __dir__, __all__ = lazy.attach_stub(__name__, __file__)

# A study knows nothing of reports, but in a notebook it is shown as one.
_DISPLAYS.register("study", "cornercase.report.inline:show_study")
