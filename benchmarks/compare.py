"""How often `cornercase compare` finds a change where there is one, and where there is none.

On both examples the ego is driven by ``normal``, and by the same driver with a reaction time that is longer, by 0.1 s
unless ``--later`` says otherwise. Each version is explored with so many scenarios and 20 seeds. Compared are:

- ``itself, other seed``: two searches of the original with different seeds, which share no scenario; any change that is
  found is an error;
- ``itself, same seed``: two searches of the original that should be the same to the last byte;
- ``later, same seed``: the original and the later driver, of which the scenarios that fill the space are the same;
- ``later, other seed``: the same with different seeds, so that there is no pair.

``changed`` is whether the versions differ. ``worse`` and ``better`` are how often something is, by the verdict.
``by tests`` is what the tests alone say of a change, as where simulators do not repeat themselves. ``first`` is the
median number of scenarios after which one went otherwise. ``share`` is how often the 90 % interval of the change of the
critical share holds 0, where there is one.

With ``--sensor`` the ego senses the traffic. With a random sensor and ``--optimizer grid``, searches with different
seeds run the same scenarios with different random numbers.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import cornercase as cc
from cornercase import NoticeWarning
from cornercase.drivers import NORMAL, SENSORS, BehaviourDriver, EquippedDriver
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.suite import Comparison
from cornercase.suite.compare._comparison import ALPHA

EXAMPLES = {"x-intersection": 0.2, "t-intersection": 1.5}
APART = 1000


def explored(
    folder: Path, example: str, optimizer: str, sensors: list[str], seed: int, budget: int, later: float
) -> Path:
    """Study of one version, made when it is asked for first."""
    path = folder / f"{example}-{optimizer}-{seed}-{later:g}.db"
    if not path.exists():
        driver = BehaviourDriver(NORMAL._replace(reaction_time=NORMAL.reaction_time + later))
        chosen = replace(
            paper_experiment_config(example, budget=budget, seed=seed),
            optimizer=optimizer,
            critical=EXAMPLES[example],
            drivers={"Ego": EquippedDriver(driver, list(map(SENSORS.create, sensors))) if sensors else driver},
        )
        with warnings.catch_warnings(action="ignore", category=NoticeWarning):
            explore_config(chosen, path)
    return path


def told(found: Comparison) -> dict[str, Any]:
    """What of a comparison counts here."""
    otherwise = [one.ids[1] for one in found.pairs if one.run == "otherwise"]
    sets = None if found.space is None else found.space.sets
    return {
        "changed": found.changed,
        "worse": bool(found.worse),
        "better": bool(found.better),
        "by tests": any(one.corrected <= ALPHA for one in found.tests),
        "pairs": len(found.pairs),
        "first": min(otherwise, default=None),
        "share holds 0": None if sets is None else sets.change.low <= 0.0 <= sets.change.high,
    }


def compared(
    folder: Path, example: str, optimizer: str, sensors: list[str], seeds: int, budget: int, later: float
) -> Iterator[tuple[str, list[Any]]]:
    """What each kind of comparison says, for each seed."""

    def study(seed: int, delay: float = 0.0, where: str = "") -> Path:
        return explored(folder / where, example, optimizer, sensors, seed, budget, delay)

    (folder / "again").mkdir(exist_ok=True)
    kinds: dict[str, Callable[[int], tuple[Path, Path]]] = {
        "itself, other seed": lambda seed: (study(seed), study(seed + APART)),
        "itself, same seed": lambda seed: (study(seed), study(seed, where="again")),
        "later, same seed": lambda seed: (study(seed), study(seed, later)),
        "later, other seed": lambda seed: (study(seed + APART), study(seed, later)),
    }
    for kind, pair in kinds.items():
        yield kind, [told(cc.compare(*pair(seed))) for seed in range(1, seeds + 1)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="two seeds")
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--budget", type=int, default=100)
    parser.add_argument("--optimizer", default="level-set")
    parser.add_argument("--later", type=float, default=0.1, metavar="S", help="delay of the later driver in s")
    parser.add_argument("--sensor", action="append", default=[], metavar="SPEC", help="such as radar:noise=0.5")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    seeds = 2 if options.quick else options.seeds
    rows = []
    print(f"{options.optimizer}, {options.budget} scenarios, {seeds} seeds")
    print(
        f"{'example':16}{'compared':20}{'changed':>8}{'worse':>6}{'better':>7}{'by tests':>9}{'pairs':>6}{'first':>6}"
        "  share holds 0"
    )
    with tempfile.TemporaryDirectory() as folder:
        for example in EXAMPLES:
            for kind, found in compared(
                Path(folder), example, options.optimizer, options.sensor, seeds, options.budget, options.later
            ):
                first = [one["first"] for one in found if one["first"] is not None]
                holds = [one["share holds 0"] for one in found if one["share holds 0"] is not None]
                row = {
                    "example": example,
                    "compared": kind,
                    "changed": sum(one["changed"] for one in found),
                    "worse": sum(one["worse"] for one in found),
                    "better": sum(one["better"] for one in found),
                    "by tests": sum(one["by tests"] for one in found),
                    "pairs": float(np.median([one["pairs"] for one in found])),
                    "first": float(np.median(first)) if first else None,
                    "share": f"{sum(holds)} of {len(holds)}",
                }
                rows.append(row | {"seeds": found})
                print(
                    f"{example:16}{kind:20}{row['changed']:8}{row['worse']:6}{row['better']:7}{row['by tests']:9}"
                    f"{row['pairs']:6.0f}{'–' if row['first'] is None else format(row['first'], '.0f'):>6}"
                    f"  {row['share']}",
                    flush=True,
                )
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
