"""The paper's two experiments at their size."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, suggestion
from cornercase._common.files import read_file, written_whole
from cornercase.exploration.configuration import Configuration
from cornercase.scenario import LogicalScenario

_DEMONSTRATIONS: Final[dict[str, dict[str, Any]]] = {
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
_MUTANTS: Final = {"t-intersection": 20}


def demonstration(
    name: str,
    *,
    budget: int | None = None,
    seed: int = 0,
    driver: str | None = None,
    simulator: str = "builtin",
    workers: int = 1,
    folder: Path | None = None,
) -> Configuration:
    """Return the configuration of one of the paper's experiments.

    `driver` replaces the file's driver of the ego. `folder`: copy the example's files there and explore those. Raises
    `InputError` for an unknown name, or if a file cannot be written or was changed.
    """
    if name not in _DEMONSTRATIONS:
        raise InputError(f"There is no example '{name}'; {suggestion(name, _DEMONSTRATIONS)}")
    stem = name.replace("-", "_")
    files = examples() / stem if folder is None else _written(examples() / stem, folder)
    configuration = Configuration(
        LogicalScenario.read(files / f"{stem}.xosc", files / f"{stem}.space.xosc"),
        ego="Ego",
        seed=seed,
        drivers={} if driver is None else {"Ego": driver},
        simulator=simulator,
        workers=workers,
        **_DEMONSTRATIONS[name],
    )
    return configuration if budget is None else replace(configuration, budget=budget)


def _written(example: Path, folder: Path) -> Path:
    """Copy the files of an example; existing files must be identical."""
    for source in sorted(example.iterdir()):
        content, copy = source.read_bytes(), folder / source.name
        if not copy.exists():
            with written_whole(copy) as temporary:
                temporary.write_bytes(content)
        elif read_file(copy) != content:
            raise InputError(f"{copy}: differs from the example's file; choose another folder, or remove it.")
    return folder


def mutants_of_demonstration(name: str) -> int | None:
    """Return how many driver mutants select the regression suite of a demonstration; None if it keeps none."""
    return _MUTANTS.get(name)


def examples() -> Path:
    """Return the folder of the examples.

    Returns
    -------
    Path
        Inside the package if installed, otherwise at the root of the checkout.
    """
    package = Path(__file__).resolve().parents[1]
    return package / "examples" if (package / "examples").is_dir() else package.parents[1] / "examples"
