"""Registry of HTML renderers for notebooks: early rooms' objects are shown by a later room."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry

DISPLAYS: Final[Registry[str | None]] = Registry("display", "cornercase.displays")
"""HTML renderers by name, such as ``"study"`` (called with its ``path``); None if there is none."""
