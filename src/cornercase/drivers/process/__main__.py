"""Copy the files that programs need for the protocol: ``python -m cornercase.drivers.process FOLDER``."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Final

_CLIENTS: Final = ("cornercase_client.py", "cornercase_client.hpp")

if __name__ == "__main__":
    folder = Path(sys.argv[1] if len(sys.argv) > 1 else ".")
    folder.mkdir(parents=True, exist_ok=True)
    for name in _CLIENTS:
        shutil.copyfile(Path(__file__).with_name(name), folder / name)
        print(folder / name)
