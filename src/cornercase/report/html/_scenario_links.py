"""Links to the replay of each scenario that a sentence names."""

from __future__ import annotations

import re
from html import escape
from typing import Final

from markupsafe import Markup

# knowledge.js has the same expression for a live page.
_NAMED_SCENARIO: Final = re.compile(r"\b[Ss]cenario (\d+)\b")


def link_scenarios(sentence: str) -> Markup:
    """Escape a sentence, and link each ``scenario 12`` in it to its replay."""
    return Markup(_NAMED_SCENARIO.sub(r"<a href='#id=\1'>\g<0></a>", escape(sentence)))
