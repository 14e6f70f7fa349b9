"""Simulators as they are hard to end: one waits for a program of its own, one is inside compiled code.

What they give follows from the parameters alone.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
from abc import abstractmethod
from pathlib import Path
from typing import Any

import numpy as np

from cornercase.recordings import Recording
from cornercase.simulators import Simulator

# It does not end when it is asked to.
PROGRAM = "trap '' TERM HUP INT; sleep 0.02; echo done > said; sleep 0.02"


class Hard(Simulator):
    def __init__(self, **options: Any) -> None:
        self.settings = {}

    @abstractmethod
    def wait(self, number: float) -> None: ...

    def run(self, concretes):
        for concrete in concretes:
            number = sum(float(value) * k for k, value in enumerate(concrete.values.values(), start=1)) % 7.0
            self.wait(number)
            still = np.zeros((2, 5))
            yield Recording(
                time=np.arange(5.0),
                names=("Ego", "Pedestrian"),
                object_types=("car", "pedestrian"),
                x=np.stack([np.zeros(5), np.linspace(9.0, 1.0 + number, 5)]),
                y=still,
                heading=still,
                speed=still,
                acceleration=still,
                length=np.full(2, 1e-6),
                width=np.full(2, 1e-6),
                center_x=np.zeros(2),
            )


class Waiting(Hard):
    """Has a program of its own run each scenario, in a temporary folder."""

    name = "waiting"

    def wait(self, number):
        folder = tempfile.mkdtemp(prefix="cornercase-")
        # Whatever ends this process, the folder is not removed here.
        subprocess.run(["sh", "-c", PROGRAM], cwd=folder, check=True)
        (Path(folder) / "said").unlink()
        Path(folder).rmdir()


class Deaf(Hard):
    """Runs each scenario in compiled code that lets no other thread of Python run."""

    name = "deaf"
    seconds = 0.05

    def wait(self, number):
        ctypes.PyDLL(None).usleep(int(1e6 * self.seconds))


class Stuck(Deaf):
    """Is deaf for longer than anybody waits."""

    name = "stuck"
    seconds = 600.0


def install(folder: Path) -> None:
    """Make them known to each process that has the folder on its path, as a package does that is installed."""
    about = folder / "stubborn_simulators-0.dist-info"
    about.mkdir(parents=True)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: killed-simulators\nVersion: 0\n", encoding="utf-8")
    names = "\n".join(f"{one.name} = stubborn_simulators:{one.__name__}" for one in (Waiting, Deaf, Stuck))
    (about / "entry_points.txt").write_text(f"[cornercase.simulators]\n{names}\n", encoding="utf-8")
