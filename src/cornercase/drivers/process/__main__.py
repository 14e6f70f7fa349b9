"""Copy the client files of the protocol for driving programs: ``python -m cornercase.drivers.process FOLDER``."""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Final

_CLIENTS: Final = ("cornercase_client.py", "cornercase_client.hpp")

if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        prog="python -m cornercase.drivers.process", description="Copy the clients of the protocol for programs."
    )
    parser.add_argument("folder", nargs="?", type=Path, default=".", help="folder to copy them to; default: this one")
    folder = parser.parse_args().folder
    folder.mkdir(parents=True, exist_ok=True)
    for name in _CLIENTS:
        shutil.copyfile(Path(__file__).with_name(name), folder / name)
        print(folder / name)
