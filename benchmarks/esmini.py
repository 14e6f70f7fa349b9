"""How far the builtin simulator agrees with esmini, row by row of a folder of expected recordings.

    python benchmarks/esmini.py FOLDER [--quick] [--json FILE] [--only TEXT]

FOLDER holds ``index.json``, which names scenarios, parameter values and what esmini made of them.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from cornercase import ConcreteScenario, InputError
from cornercase.recordings import Recording
from cornercase.simulators import BuiltinSimulator

Floats = npt.NDArray[np.float64]
LIMITS = {"position": 0.25, "heading": 0.05, "speed": 0.25, "end": 0.15}
UNITS = {"position": "m", "heading": "rad", "speed": "m/s", "end": "s"}


def expected_tracks(path: Path) -> dict[str, Floats]:
    tracks: dict[str, list[list[float]]] = {}
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            values = [float(row[key] or "nan") for key in ("time", "x", "y", "heading", "speed")]
            if np.isfinite(values[:3]).all():
                track = tracks.setdefault(row["entity"], [])
                # The frame in which a storyboard stops is written too, at the time of the one before.
                if not track or values[0] > track[-1][0]:
                    track.append(values)
    return {name: np.array(track) for name, track in tracks.items()}


def errors(expected: Floats, recording: Recording, name: str) -> dict[str, float]:
    """Return the largest errors of one entity at the instants that both have."""
    if name not in recording.names:
        return dict.fromkeys(LIMITS, np.inf)
    k = recording.names.index(name)
    there = np.isfinite(recording.x[k])
    time_, motion = (
        recording.time[there],
        [a[k][there] for a in (recording.x, recording.y, recording.heading, recording.speed)],
    )
    if not len(time_):
        return dict.fromkeys(LIMITS, np.inf)
    shared = expected[expected[:, 0] <= min(time_[-1], expected[-1, 0]) + 1e-9]
    x, y, heading, speed = (
        np.interp(shared[:, 0], time_, one) for one in (*motion[:2], np.unwrap(motion[2]), motion[3])
    )
    turn = np.abs((shared[:, 3] - heading + np.pi) % (2 * np.pi) - np.pi)
    return {
        "position": float(np.hypot(shared[:, 1] - x, shared[:, 2] - y).max()),
        "heading": float(turn.max()),
        "speed": float(np.abs(shared[:, 4] - speed).max()),
        "end": float(abs(time_[-1] - expected[-1, 0])),
    }


def judge(row: dict[str, Any], folder: Path) -> tuple[bool, str]:
    """Return whether a row matches, and the reason where it does not."""
    # So long as the expected recording, which ends after 40 s at the latest.
    tracks = expected_tracks(folder / "expected" / row["expected"])
    last = max(track[-1, 0] for track in tracks.values())
    simulator = BuiltinSimulator(time_step=0.05, duration=min(40.0, last + 1.0))
    try:
        (result,) = simulator.run([ConcreteScenario(folder / row["scenario"], dict(row["parameters"]))])
    except InputError as error:
        return False, str(error).replace(str(folder) + "/", "")
    if not isinstance(result, Recording):
        return False, str(result)
    for name, track in tracks.items():
        worst = errors(track, result, name)
        off = [f"{key} {worst[key]:.3g} {UNITS[key]}" for key, limit in LIMITS.items() if worst[key] > limit]
        if off:
            return False, f"{name}: {', '.join(off)}"
    return True, ""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?")
    parser.add_argument("--quick", action="store_true", help="every ninth row")
    parser.add_argument("--only", default="", help="rows whose expected recording has this in its name")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.folder is None:
        print("esmini: no folder of expected recordings was given, nothing is compared.")
        return 0
    rows = json.loads((arguments.folder / "index.json").read_text())
    rows = [row for row in rows if arguments.only in row["expected"]][:: 9 if arguments.quick else 1]
    table = []
    for row in rows:
        begun = time.perf_counter()
        good, why = judge(row, arguments.folder)
        seconds = time.perf_counter() - begun
        table.append({"row": row["expected"].removesuffix(".csv"), "matches": good, "why": why, "seconds": seconds})
        print(f"{'ok ' if good else 'OFF'} {seconds:6.2f} s  {table[-1]['row']}  {why}", flush=True)
    print(f"{sum(one['matches'] for one in table)} of {len(table)} match.")
    if arguments.json:
        arguments.json.write_text(json.dumps(table, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
