"""List everything in the package that breaks a rule of the house, and exit with 1 if there is any.

``known.txt`` holds what broke a rule when the rule came, without line numbers, and has yet to be mended: nothing is
added to it, and what is mended leaves it. ``python -m lint --write`` writes it again.
"""

from __future__ import annotations

import re
import sys
from collections import Counter
from itertools import chain
from pathlib import Path

from lint import docstrings, layout, public_docstrings, words

KNOWN = Path(__file__).with_name("known.txt")


def without_line(complaint: str) -> str:
    """Drop the line number, which changes with everything above it, and sort sets."""
    complaint = re.sub(r"^(\S+?):\d+: ", r"\1: ", complaint)
    return re.sub(r"\{(.*?)\}", lambda part: f"{{{', '.join(sorted(part[1].split(', ')))}}}", complaint)


def main(arguments: list[str]) -> int:
    complaints = sorted(chain(layout.check(), words.check(), docstrings.check(), public_docstrings.check()))
    counts = Counter(map(without_line, complaints))
    if arguments == ["--write"]:
        KNOWN.write_text("".join(f"{line}\n" for line in sorted(counts.elements())), encoding="utf-8")
        return 0
    known = Counter(KNOWN.read_text(encoding="utf-8").splitlines())
    new = [complaint for complaint in complaints if counts[without_line(complaint)] > known[without_line(complaint)]]
    mended = [f"{line}: is mended; remove it from {KNOWN.name}" for line in sorted((known - counts).elements())]
    print(
        "\n".join([*new, *mended]) if new or mended else f"Nothing new breaks a rule; {known.total()} known places do."
    )
    return bool(new or mended)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
