"""A file that shows how a simulator did in the small scenarios, to attach to an issue."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from zipfile import ZIP_DEFLATED, ZipFile

import numpy as np

from cornercase import __version__
from cornercase._common.io.files import atomic_write
from cornercase.recordings import Recording
from cornercase.simulators import SIMULATORS, Simulator
from cornercase.testing._contract_check import CheckResult
from cornercase.testing._deviations import TOLERANCES, SmallRun
from cornercase.testing._small_scenarios import write_small_scenarios


def write_proof(
    path: Path, simulator: str | Simulator, results: Sequence[CheckResult], runs: Sequence[SmallRun]
) -> None:
    """Write a ZIP file with what checks of a simulator found, the small scenarios, and the recordings of both."""
    with atomic_write(path) as temporary, ZipFile(temporary, "w", ZIP_DEFLATED) as archive:
        archive.writestr("proof.json", json.dumps(_describe(simulator, results, runs), indent=1, ensure_ascii=False))
        with TemporaryDirectory() as name:
            folder = Path(name)
            write_small_scenarios(folder)
            for file in sorted(folder.iterdir()):
                archive.write(file, f"scenarios/{file.name}")
            for run in runs:
                for who, recording in (("own", run.own), ("builtin", run.expected)):
                    if recording is not None:
                        table = folder / "recording.csv"
                        recording.to_csv(table)
                        archive.write(table, f"recordings/{run.name.replace(' ', '_')}.{who}.csv")


def _describe(
    simulator: str | Simulator, results: Sequence[CheckResult], runs: Sequence[SmallRun]
) -> Mapping[str, Any]:
    availability = SIMULATORS.get_class(simulator).availability()
    return {
        "simulator": simulator if isinstance(simulator, str) else type(simulator).__qualname__,
        "version": availability.version,
        "features": availability.features,
        "cornercase": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "checks": [asdict(result) for result in results],
        "tolerances": TOLERANCES,
        "scenarios": [
            {
                "name": run.name,
                "problem": run.problem,
                "seconds": round(run.seconds, 3),
                "seconds_again": round(run.seconds_again, 3),
                "spread": None if run.spread is None else float(f"{run.spread:.4g}"),
                "boxes": None if run.own is None else _boxes(run.own),
                "deviations": None if run.deviations is None else _rounded(asdict(run.deviations)),
            }
            for run in runs
        ],
    }


def _rounded(deviations: Mapping[str, float]) -> dict[str, float | None]:
    """Return deviations to 4 digits; None for one that is infinite, which JSON does not know."""
    return {name: float(f"{value:.4g}") if np.isfinite(value) else None for name, value in deviations.items()}


def _boxes(recording: Recording) -> dict[str, list[float]]:
    """Return length and width of each entity in m."""
    return {
        name: [round(float(length), 3), round(float(width), 3)]
        for name, length, width in zip(recording.names, recording.length, recording.width, strict=True)
    }
