"""ZIP file with the results of a simulator's checks, to attach to an issue."""

from __future__ import annotations

import json
import os
import platform
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from cornercase import __version__
from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write
from cornercase.recordings import Recording
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.simulators._registry import simulator_availability
from cornercase.testing._agent_runs import AGENT_LIMITS
from cornercase.testing._contract_check import CheckResult
from cornercase.testing._crash import SimulatorCrashResult
from cornercase.testing._deviations import TOLERANCES, UNITS, SmallRun
from cornercase.testing._small_scenarios import AGENT_DURATIONS, SMALL_SCENARIOS, write_small_scenarios


def write_check_archive(
    path: Path,
    simulator: str | Simulator,
    results: Sequence[CheckResult],
    runs: Sequence[SmallRun],
    crashes: Sequence[SimulatorCrashResult],
) -> None:
    """Write a ZIP file with a simulator's check results, the small scenarios, and their recordings.

    The recordings are those of the checked simulator and, for comparison, of the builtin simulator.
    """
    proof = _make_archive_summary(simulator, results, runs, crashes)
    with atomic_write(path) as temporary, ZipFile(temporary, "w", ZIP_DEFLATED) as archive:
        archive.writestr("summary.txt", _format_archive_summary(proof))
        archive.writestr("proof.json", json.dumps(proof, indent=1, ensure_ascii=False))
        with TemporaryDirectory() as name:
            folder = Path(name)
            write_small_scenarios(folder, *SMALL_SCENARIOS, *AGENT_DURATIONS)
            for file in sorted(folder.iterdir()):
                archive.write(file, f"scenarios/{file.name}")
            for run in runs:
                for who, recording in (("own", run.own), ("builtin", run.expected)):
                    if recording is not None:
                        table = folder / "recording.csv"
                        recording.to_csv(table)
                        archive.write(table, f"recordings/{_file_stem(run)}.{who}.csv")


def _make_archive_summary(
    simulator: str | Simulator,
    results: Sequence[CheckResult],
    runs: Sequence[SmallRun],
    crashes: Sequence[SimulatorCrashResult],
) -> Mapping[str, Any]:
    availability = simulator_availability(simulator)
    settings, versions = _read_settings_and_versions(simulator)
    return {
        "simulator": simulator if isinstance(simulator, str) else type(simulator).__qualname__,
        "version": availability.version,
        "features": availability.features,
        "versions": versions,
        "settings": settings,
        "cornercase": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": platform.processor() or platform.machine(),
        "n_processors": os.cpu_count(),
        "checks": [asdict(result) | {"seconds": _round(result.seconds)} for result in results],
        "tolerances": TOLERANCES,
        "agent_limits": AGENT_LIMITS,
        "scenarios": [
            {
                "name": run.name,
                "agent": run.agent,
                "problem": run.problem,
                "seconds": _round(run.seconds),
                "seconds_again": _round(run.seconds_again),
                "spread": _round(run.spread),
                "boxes": None if run.own is None else _boxes(run.own),
                "deviations": None if run.deviations is None else _rounded(asdict(run.deviations)),
                "motion": None if run.motion is None else _rounded(asdict(run.motion)),
            }
            for run in runs
        ],
        "crashes": [
            {
                "killed": run.killed,
                "is_server": run.is_server,
                "n_scenarios": len(run.outcomes),
                "n_before": run.n_before,
                "n_lost": run.n_lost,
                "spread": _round(run.spread),
                "seconds": [_round(seconds) for seconds in run.seconds],
            }
            for run in crashes
        ],
    }


def _read_settings_and_versions(simulator: str | Simulator) -> tuple[Mapping[str, object], Mapping[str, str]]:
    """Return a simulator's settings that recordings depend on, and versions of its programs.

    Both are empty if the simulator cannot be created, for example because a program is not installed.
    """
    try:
        created = SIMULATORS.create(simulator) if isinstance(simulator, str) else simulator
        return dict(created.settings), created.component_versions()
    except InputError:
        return {}, {}


def _format_archive_summary(proof: Mapping[str, Any]) -> str:
    """Return the main results as text, for a reader who opens the ZIP file."""
    lines = [
        f"{proof['simulator']}, version {proof['version'] or 'unknown'}",
        *(f"{name}: {version or 'unknown'}" for name, version in proof["versions"].items()),
        f"cornercase {proof['cornercase']}, Python {proof['python']}, {proof['platform']},"
        f" {proof['n_processors']} processors",
        "",
    ]
    for check in proof["checks"]:
        outcome = "not run" if check["blocked_by"] else "not tried" if check["not_tried"] else ""
        outcome = outcome or ("FAILED" if check["problem"] else "ok")
        lines.append(f"{outcome:10}{check['seconds']:8.1f} s  {check['name']}")
        lines += [f"{'':22}{sentence}" for sentence in (check["problem"], check["not_tried"]) if sentence]
    lines += ["", *_format_table(proof["scenarios"])]
    for run in proof["crashes"]:
        what = "its server" if run["is_server"] else "its worker process"
        lines += [
            "",
            f"{what} was killed after {run['n_before']} of {run['n_scenarios']} scenarios; {run['n_lost']} were lost;"
            f" the longest took {max(run['seconds']):.2f} s",
        ]
    return "\n".join(lines) + "\n"


def _format_table(runs: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the deviations of all runs as lines of a table."""
    rows = [
        ["scenario", *(f"{name} [{UNITS[name]}]" for name in TOLERANCES), "spread [m]", "seconds", "again"],
        ["(at most)", *(f"{value:g}" for value in TOLERANCES.values()), "", "", ""],
    ]
    for run in runs:
        deviations = run["deviations"]
        cells = ["" if deviations is None else _format(deviations[name], "any") for name in TOLERANCES]
        name = f"{run['name']}, {run['agent']}" if run["agent"] else run["name"]
        rows.append([name, *cells, _format(run["spread"], "?"), f"{run['seconds']:.2f}", f"{run['seconds_again']:.2f}"])
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        numbers = (cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))
        lines.append("  ".join([row[0].ljust(widths[0]), *numbers]))
    return lines


def _format(value: float | None, missing: str) -> str:
    return missing if value is None else f"{value:.3g}"


def _file_stem(run: SmallRun) -> str:
    name = f"{run.name} {run.agent}".strip()
    return re.sub(r"\W+", "_", name).strip("_")


def _rounded(numbers: Mapping[str, float | None]) -> dict[str, float | None]:
    """Return numbers rounded to 4 significant digits."""
    return {name: _round(value) for name, value in numbers.items()}


def _round(value: float | None) -> float | None:
    """Return a number rounded to 4 significant digits; None for an infinite number, which JSON cannot hold."""
    return float(f"{value:.4g}") if value is not None and np.isfinite(value) else None


def _boxes(recording: Recording) -> dict[str, list[float]]:
    """Return length and width of each entity in m."""
    return {
        name: [round(float(length), 3), round(float(width), 3)]
        for name, length, width in zip(recording.names, recording.length, recording.width, strict=True)
    }
