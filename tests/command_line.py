"""The command line in a process of its own."""

from __future__ import annotations

import subprocess
import sys

from conftest import EXAMPLES

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"
SPACE = EXAMPLES / "x_intersection" / "x_intersection.space.xosc"


def cornercase(*arguments, cwd=None) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", "from cornercase.cli import main; main()", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=300)
