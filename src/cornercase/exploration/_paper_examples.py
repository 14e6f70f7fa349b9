"""The two experiments of the paper, at their original size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggest_name
from cornercase._common.io.files import atomic_write, read_file
from cornercase.exploration._config import ExplorationConfig
from cornercase.scenario import LogicalScenario

_EXPERIMENT_SETTINGS: Final[dict[str, dict[str, Any]]] = {
    "x-intersection": {
        "other": "Pedestrian",
        "metrics": ("wttc", "trajectory-distance"),
        # With the metric's own threshold nearly all would be critical: the two always meet, but mostly slowly.
        "critical": 0.2,
        "budget": 400,
        "on_collision": "continue",
    },
    "t-intersection": {
        "other": "C",
        "metrics": ("ttc", "distance", "traffic-quality", "wttc"),
        "budget": 300,
        "on_collision": "stop",
    },
}

# The T-intersection is the paper's example of drivers that differ.
_MUTANT_COUNTS: Final = {"t-intersection": 20}


def paper_experiment_config(
    name: str,
    *,
    budget: int | None = None,
    seed: int = 0,
    driver: str | None = None,
    simulator: str = "builtin",
    workers: int = 1,
    folder: Path | None = None,
) -> ExplorationConfig:
    """Return the configuration of one of the paper's experiments, searched by `bayes` as in the paper.

    `driver` replaces the driver of the ego in the file. If a `folder` is given, the example's files are copied to this
    folder and explored there. Raises `InputError` if the name is unknown, or a file in the folder cannot be written or
    differs from the example's file.
    """
    if name not in _EXPERIMENT_SETTINGS:
        raise InputError(f"There is no example '{name}'; {suggest_name(name, _EXPERIMENT_SETTINGS)}")
    stem = name.replace("-", "_")
    files = examples_folder() / stem if folder is None else _copy_example_files(examples_folder() / stem, folder)
    configuration = ExplorationConfig(
        LogicalScenario.read(files / f"{stem}.xosc", files / f"{stem}.space.xosc"),
        ego="Ego",
        # With `auto`, a demonstration would take 1.6 times as long.
        optimizer="bayes",
        seed=seed,
        drivers={} if driver is None else {"Ego": driver},
        simulator=simulator,
        workers=workers,
        **_EXPERIMENT_SETTINGS[name],
    )
    return configuration if budget is None else replace(configuration, budget=budget)


def _copy_example_files(example: Path, folder: Path) -> Path:
    """Copy the files of an example into a folder; files that exist there must be identical."""
    for source in sorted(example.iterdir()):
        content, copy = source.read_bytes(), folder / source.name
        if not copy.exists():
            with atomic_write(copy) as temporary:
                temporary.write_bytes(content)
        elif read_file(copy) != content:
            raise InputError(f"{copy}: differs from the example's file; choose another folder, or remove the file.")
    return folder


def paper_experiment_mutant_count(name: str) -> int | None:
    """Return how many driver mutants a demonstration creates to select a test suite; None if it selects no suite.

    A mutant is the ego's driver with one parameter degraded.
    """
    return _MUTANT_COUNTS.get(name)


def examples_folder() -> Path:
    """Return the folder of the examples.

    Returns
    -------
    Path
        Folder inside the installed package, or at the root of a source checkout.

    Examples
    --------
    >>> from cornercase.exploration import examples_folder
    >>> (examples_folder() / "r157" / "cut_in.xosc").is_file()
    True
    """
    package = Path(__file__).resolve().parents[1]
    return package / "examples" if (package / "examples").is_dir() else package.parents[1] / "examples"
