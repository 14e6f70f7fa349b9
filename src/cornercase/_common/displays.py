"""Registry of HTML renderers for notebooks: early rooms' objects are shown by a later room."""

from __future__ import annotations

from typing import Final

from cornercase._common.registry import Registry

DISPLAYS: Final[Registry[str | None]] = Registry("display", "cornercase.displays")
"""What makes HTML of a thing, by its name: of a ``"study"`` from its ``path``; None where there is none."""
