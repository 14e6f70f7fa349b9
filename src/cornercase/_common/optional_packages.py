"""Advice for messages about a missing optional package."""

from __future__ import annotations

import platform


def describe_install(extra: str) -> str:
    """Describe in a clause how to install an extra (optional packages), or say that the extra is empty here.

    An extra is empty if it contains no package for this version of Python and this machine.

    >>> print(describe_install("sumo"))
    install it with pip install 'cornercase[sumo]'
    """
    if not is_empty_extra(extra):
        return f"install it with pip install 'cornercase[{extra}]'"
    where = f"Python {_python_version()} on {platform.system()} {platform.machine()}"
    return f"there is none for {where}, where the extra '{extra}' installs nothing"


def is_empty_extra(extra: str) -> bool:
    """Return whether an extra (optional packages) installs nothing on this Python and machine; False if unknown."""
    # Imported here: most commands need no extra.
    from importlib.metadata import PackageNotFoundError, requires

    from packaging.requirements import Requirement

    try:
        requirements = [Requirement(text) for text in requires("cornercase") or ()]
    except PackageNotFoundError:
        return False
    markers = [item.marker for item in requirements if item.marker is not None]
    of_extra = [marker for marker in markers if f'extra == "{extra}"' in str(marker)]
    environment = {"extra": extra, "python_version": _python_version(), "platform_machine": platform.machine()}
    return bool(of_extra) and not any(marker.evaluate(environment) for marker in of_extra)


def _python_version() -> str:
    return ".".join(platform.python_version_tuple()[:2])
