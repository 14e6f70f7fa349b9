"""How long one waits before anything happens: importing, asking for help, opening a large study.

    python benchmarks/startup.py [--quick] [--json FILE]

Each figure is the fastest of several processes, beside an interpreter that does nothing (``python -c pass``). The study
has 5,000 scenarios with recordings and courses, and is clustered by two aspects, with all distances.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from cornercase.recordings import Recording
from cornercase.scenario import ParameterSpace
from cornercase.study import StudyFile, StudyMeta

INSTANTS = 200
ASPECTS = ("ego-trajectory", "distance")


def write_study(path: Path, scenarios: int) -> None:
    """Write a study of two cars, the second of which stands somewhere else in each scenario."""
    space = ParameterSpace.from_ranges(["a=0:1", "b=0:1"])
    points = np.random.default_rng(0).random((scenarios, 2))
    meta = StudyMeta(
        scenario="synthetic.xosc", fingerprint="0", space=space, ego="Ego", other="B", metrics=("distance",),
        optimizer="random", simulator="builtin", critical=0.5, budget=scenarios, batch=scenarios,
    )  # fmt: skip
    time_, still = np.arange(INSTANTS) * 0.05, np.zeros((2, INSTANTS))
    with StudyFile.create(path, meta) as study:
        for row in study.writer.add_pending(1, points, space.values(points)):
            x = np.stack([time_ * 10.0, np.full(INSTANTS, 100.0 * row.point[0])])
            recording = Recording(
                time=time_, names=("Ego", "B"), object_types=("car", "car"), x=x, y=still, heading=still, speed=still,
                acceleration=still, length=np.full(2, 4.0), width=np.full(2, 2.0), center_x=np.zeros(2),
            )  # fmt: skip
            course = np.abs(x[1] - x[0])
            study.writer.record_result(row.id, recording, {"distance": (course, float(course.min()))})
        distances = np.abs(points[:, :1] - points[:, 0])
        for aspect in ASPECTS:
            study.writer.save_analysis(
                aspect,
                {
                    "ids": np.arange(1, scenarios + 1),
                    "distances": distances,
                    "labels": (points[:, 0] > 0.5).astype(np.int64),
                    "embedding": np.tile(points[:, :1], (1, 3)),
                },
                {},
            )


def fastest(command: list[str], times: int) -> float:
    """Seconds of the fastest of several runs of a command."""
    seconds = []
    for _ in range(times):
        begun = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
        seconds.append(time.perf_counter() - begun)
    return min(seconds)


def within(program: str, times: int) -> float:
    """Seconds that a program tells of a part of itself, of the fastest of several processes."""
    return min(
        float(subprocess.run([sys.executable, "-c", program], check=True, capture_output=True, text=True).stdout)
        for _ in range(times)
    )


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="1,000 scenarios, and fewer runs.")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    times, scenarios = (3, 1000) if options.quick else (10, 5000)

    python = [sys.executable, "-c"]
    rows = [
        ("python -c pass", None, fastest([*python, "pass"], times)),
        ("import cornercase", 0.2, fastest([*python, "import cornercase"], times)),
        ("cornercase --help", 0.5, fastest([*python, "from cornercase.cli import main; main()", "--help"], times)),
    ]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "study.db"
        write_study(path, scenarios)
        # What a program has imported before is not the study's to answer for.
        opening = f"""
import time
import pandas
from cornercase.study import StudyFile
begun = time.perf_counter()
with StudyFile.open({str(path)!r}, readonly=True) as study:
    table = study.table()
assert len(table) == {scenarios}
print(time.perf_counter() - begun)
"""
        rows.append((f"open and table() of {scenarios:,}", 1.0, within(opening, times)))
        whole = f"import cornercase as cc; cc.Study.open({str(path)!r}).table()"
        rows.append(("the same, from the start of Python", None, fastest([*python, whole], times)))

    print(f"{'':36}{'s':>8}{'bound':>8}{'times pass':>12}")
    for name, bound, seconds in rows:
        print(f"{name:36}{seconds:8.3f}{'' if bound is None else f'{bound:.1f}':>8}{seconds / rows[0][2]:12.1f}")
    if options.json:
        table = [{"what": name, "bound": bound, "seconds": seconds} for name, bound, seconds in rows]
        options.json.write_text(json.dumps(table, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
