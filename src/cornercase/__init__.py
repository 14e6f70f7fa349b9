"""Find, cluster and reduce the critical concrete scenarios of a logical scenario."""

import sys as _sys
from importlib import import_module as _import_module

# Python puts the current folder first for ``python -m``, and a stranger's modules may lie there.
if (
    ("-m", "cornercase") in zip(_sys.orig_argv, _sys.orig_argv[1:], strict=False)
    and _sys.argv[:1] == ["-m"]
    and not _sys.flags.safe_path
):
    del _sys.path[0]

import lazy_loader as lazy

from cornercase._common.current_folder import ignore_settings_of_current_folder as _take_no_settings
from cornercase._common.unknown_names import unknown_attribute_error as _unknown_attribute
from cornercase._common.version import __version__ as __version__

# Rooms that are attributes without being imported first, but not shown by dir().
_FURTHER_ROOMS = (
    "clustering", "dtw", "evidence", "exploration", "recordings", "reduction", "report", "roads", "scenario", "study",
    "suite", "testing",
)  # fmt: skip

_take_no_settings()

_get_public_name, __dir__, __all__ = lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """Import a public name when it is first used."""
    try:
        return _get_public_name(name)
    except AttributeError:
        if name in __all__:
            raise
        if name in _FURTHER_ROOMS:
            return _import_module(f"cornercase.{name}")
        raise _unknown_attribute("module 'cornercase'", name) from None
