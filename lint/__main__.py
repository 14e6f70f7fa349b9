"""List everything in the package that breaks a rule of the house, and exit with 1 if there is any."""

from __future__ import annotations

import sys
from itertools import chain

from lint import docstrings, layout, public_docstrings, words


def main() -> int:
    complaints = sorted(chain(layout.check(), words.check(), docstrings.check(), public_docstrings.check()))
    print("\n".join(complaints) if complaints else "All rules of the house are kept.")
    return bool(complaints)


if __name__ == "__main__":
    sys.exit(main())
