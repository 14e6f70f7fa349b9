"""Whether clusters of real studies say how scenarios end, in each aspect.

    python benchmarks/outcomes.py [--quick] [--seed N] [--ncap FOLDER] [--json FILE]

Studies are of Sobol points: both examples at the size of their demonstrations, the T-intersection also with the driver
``aggressive``, and all scenarios of Euro NCAP's CA-FC 2026 in which a driver ``normal`` at the ego's wheel meets
somebody whose way crosses the ego's, and at least two outcomes come about in 5 % each. ``--quick`` takes the examples
only. FOLDER holds ``CA-FC_2026``.

Figures are the adjusted mutual information (Vinh et al. 2010) of the clusters with the outcome, as
`describe_outcome` tells it, and with whether the ego was first. Peers get the same distances:
HDBSCAN of scikit-learn with its default settings, and k-medoids, which is told how many outcomes there are.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.cluster import HDBSCAN
from sklearn.metrics import adjusted_mutual_info_score

from cornercase import LogicalScenario, Recording
from cornercase.clustering import ASPECTS, ScenarioClustering
from cornercase.dtw import distance_matrix
from cornercase.metrics._ending import describe_outcome
from cornercase.optimizers import Sobol
from cornercase.reduction._medoids import find_k_medoids
from cornercase.simulators import Builtin

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"
NCAP = ROOT.parent / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP"

# Ranges of the test protocols, made continuous, down to the slowest ego.
_PEDESTRIAN = ("Ego_speed_kph=10:60", "ImpactLocation=10:90", "VRU_finalSpeed_kph=3:8")
_CYCLIST = ("Ego_speed_kph=10:60", "ImpactLocation=10:90", "VRU_finalSpeed_kph=8:25")
_CARS = ("Ego_speed_kph=10:40", "Target_final_speed_kph=20:60")
_PROTOCOLS: dict[str, tuple[str, tuple[str, ...]]] = {
    "CBFA": ("VRU", _CYCLIST),
    "CBNA": ("VRU", _CYCLIST),
    "CBNAO": ("VRU", _CYCLIST),
    "CCCscp": ("Target", _CARS),
    "CCFtap": ("Target", _CARS),
    "CPNA": ("VRU", _PEDESTRIAN),
    "CPNCO": ("VRU", _PEDESTRIAN),
}
LEAST = 0.05

Row = dict[str, Any]


@dataclass(frozen=True)
class Explored:
    """Scenarios that were run, and how they ended."""

    recordings: list[Recording]
    other: str
    outcomes: npt.NDArray[np.str_]

    @property
    def shares(self) -> Mapping[str, float]:
        """Share of each outcome."""
        names, counts = np.unique(self.outcomes, return_counts=True)
        return dict(zip(names.tolist(), (counts / len(self.outcomes)).tolist(), strict=True))


def explored(
    logical: LogicalScenario, other: str, count: int, seed: int, driver: str | None, on_collision: str
) -> Explored:
    """Run Sobol points of a logical scenario."""
    points = Sobol().start(logical.space, seed).ask(count)
    concretes = [logical.concrete_scenario(values) for values in logical.space.values(points)]
    drivers = {} if driver is None else {"Ego": driver}
    simulator = Builtin(duration=40.0, on_collision=on_collision, drivers=drivers)
    recordings = [one for one in simulator.run(concretes) if isinstance(one, Recording)]
    outcomes = np.array([describe_outcome(one, "Ego", other) for one in recordings])
    return Explored(recordings, other, outcomes)


def studies(quick: bool, seed: int, ncap: Path) -> Iterator[tuple[str, Explored]]:
    """Give all studies by name; those that end in one way only are told and left out."""
    for stem, other, count, driver, ends in (
        ("x_intersection", "Pedestrian", 400, None, "continue"),
        ("t_intersection", "C", 300, None, "stop"),
        ("t_intersection", "C", 300, "aggressive", "stop"),
    ):
        logical = LogicalScenario.read(EXAMPLES / stem / f"{stem}.xosc", EXAMPLES / stem / f"{stem}.space.xosc")
        yield f"{stem} {driver or 'normal'}", explored(logical, other, count, seed, driver, ends)
    for name, (other, ranges) in {} if quick else _PROTOCOLS.items():
        path = ncap / "CA-FC_2026" / f"{name}.xosc"
        if not path.is_file():
            print(f"{path} is not here.")
            continue
        logical = LogicalScenario.read(path, None, ranges, continuous=True)
        found = explored(logical, other, 400, seed, "normal", "continue")
        if sum(share >= LEAST for share in found.shares.values()) < 2:
            print(f"{name}: left out, as nearly all ends in one way: {told(found)}")
            continue
        yield name, found


def told(found: Explored) -> str:
    """Shares of the outcomes in words."""
    return ", ".join(f"{name} {share:.1%}" for name, share in sorted(found.shares.items(), key=lambda one: -one[1]))


def rows_of(name: str, found: Explored) -> Iterator[Row]:
    """Cluster one study in each aspect."""
    first = np.char.startswith(found.outcomes, "Ego first")
    kinds = sum(share >= LEAST for share in found.shares.values())
    for aspect in ASPECTS.names():
        chosen = ASPECTS.create(aspect)
        distances = distance_matrix([chosen.series(one, "Ego", found.other) for one in found.recordings])
        model = ScenarioClustering().fit(distances)
        medoids = find_k_medoids(distances, kinds)
        peers = {
            "hdbscan": HDBSCAN(metric="precomputed", copy=True).fit_predict(distances),
            "k-medoids": distances[:, medoids].argmin(axis=1),
        }
        labels = model.labels_
        yield {
            "study": name,
            "aspect": aspect,
            "sizes": np.bincount(labels[labels >= 0]).tolist(),
            "noise": float((labels < 0).mean()),
            "outcome": float(adjusted_mutual_info_score(found.outcomes, labels)),
            "first": float(adjusted_mutual_info_score(first, labels)),
            **{peer: float(adjusted_mutual_info_score(found.outcomes, each)) for peer, each in peers.items()},
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--ncap", type=Path, default=NCAP)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    rows: list[Row] = []
    for name, found in studies(options.quick, options.seed, options.ncap):
        print(f"\n{name}: {len(found.recordings)} scenarios; {told(found)}")
        print(f"{'aspect':16}{'outcome':>9}{'first':>9}{'hdbscan':>9}{'k-medoids':>11}  sizes, noise")
        for row in rows_of(name, found):
            rows.append(row)
            figures = f"{row['outcome']:9.2f}{row['first']:9.2f}{row['hdbscan']:9.2f}{row['k-medoids']:11.2f}"
            print(f"{row['aspect']:16}{figures}  {row['sizes']}, {row['noise']:.0%}", flush=True)
    print("\nmedian of all studies")
    for aspect in ASPECTS.names():
        medians = [row["outcome"] for row in rows if row["aspect"] == aspect]
        print(f"{aspect:16}{np.median(medians):9.2f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
