"""``python -m cornercase``: the command line."""

from __future__ import annotations

from cornercase.cli import main

if __name__ == "__main__":
    main()
