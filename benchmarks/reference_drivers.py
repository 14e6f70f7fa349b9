"""Whether the reference drivers of UN Regulation No. 157 prevent what the Commission's implementation prevents.

    python benchmarks/reference_drivers.py --r157 FOLDER [--quick] [--sample N] [--seed N] [--json FILE]

FOLDER holds ``cut_in.csv``, ``cut_out.csv`` and ``deceleration.csv`` with outcomes of JRC-FSM, the open implementation
of the European Commission's Joint Research Centre. Each row is compared with the models by themselves, in the set-up
of that implementation (`cornercase.drivers.drive_cut_in` and the like): share of rows with the same crash or none, and
with the same fuzzy metrics to 1e-6. N rows of each file and model, drawn at random, are run as OpenSCENARIO in the
builtin simulator (``examples/r157``), in the same time steps and in finer ones. Where these end otherwise, the cause is
looked for by the model by itself: whether it differs as well, or ends otherwise with a gap that 0.1 s of closing make
longer or shorter. ``--quick`` takes 300 rows and the first time step alone.

Of a scenario file a driver is not told when the encounter is over; where the set-up says that the careful and competent
human has time, it is over at the intrusion here as well. Rows without lateral motion are not run: nobody cuts in.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
import pandas as pd

from cornercase import Recording, SimulationError
from cornercase.drivers import EncounterOutcome, drive_cut_in, drive_cut_out, drive_deceleration
from cornercase.drivers.references.r157._models import REFERENCES
from cornercase.scenario import ConcreteScenario
from cornercase.simulators import Builtin

EXAMPLES: Final = Path(__file__).resolve().parents[1] / "examples" / "r157"
NAMES: Final = {"CC_human_driver": "cc-human", "FSM": "fsm", "RSS": "rss", "Reg157": "reg157"}
FILES: Final = ("cut_in", "cut_out", "deceleration")
TIME_STEPS: Final = (0.1, 0.05)
LENGTH, WIDTH, URGENT = 4.3, 1.9, 2.0

Floats = npt.NDArray[np.float64]


def by_itself(file: str, name: str, rows: pd.DataFrame) -> EncounterOutcome:
    """What a model does in the set-up of the rows."""
    if file == "deceleration":
        return drive_deceleration(name, column(rows, "speed_kmh") / 3.6, column(rows, "deceleration_g"))
    # Lateral speeds of the rows are whole multiples of 0.1, as they come out of a multiplication.
    lateral = np.round(np.abs(column(rows, "lateral_m_s")) * 10.0) * 0.1
    if file == "cut_out":
        return drive_cut_out(name, column(rows, "speed_kmh") / 3.6, column(rows, "front_gap_m"), lateral)
    speeds = column(rows, "ego_kmh") / 3.6, column(rows, "other_kmh") / 3.6
    return drive_cut_in(name, *speeds, column(rows, "gap_m"), lateral)


def column(rows: pd.DataFrame, name: str) -> Floats:
    return rows[name].to_numpy(dtype=np.float64)


def as_scenarios(file: str, name: str, rows: pd.DataFrame) -> list[ConcreteScenario]:
    """The same as concrete scenarios."""
    if file == "cut_in":
        values = {"ego_kmh": column(rows, "ego_kmh"), "other_kmh": column(rows, "other_kmh")}
        values |= {"gap": column(rows, "gap_m"), "lateral_speed": column(rows, "lateral_m_s")}
    else:
        values = {
            "ego_kmh": column(rows, "speed_kmh"),
            "gap": REFERENCES[name].following_gap(column(rows, "speed_kmh") / 3.6),
        }
        if file == "cut_out":
            values |= {"front_gap": column(rows, "front_gap_m"), "lateral_speed": -column(rows, "lateral_m_s")}
        else:
            values["deceleration"] = column(rows, "deceleration_g")
    each = zip(*(one.tolist() for one in values.values()), strict=True)
    return [ConcreteScenario(EXAMPLES / f"{file}.xosc", dict(zip(values, one, strict=True))) for one in each]


def crashed(file: str, name: str, run: Recording | SimulationError) -> bool:
    """Whether the ego collided, before the encounter was over."""
    if isinstance(run, SimulationError):
        raise run
    if file == "cut_in" and name == "cc-human":
        ego, other = run.names.index("Ego"), run.names.index("Other")
        beside = np.abs(run.y[other] - run.y[ego]) < WIDTH - 1e-6
        if beside.any():
            at = int(beside.argmax())
            gap = run.x[other, at] - run.x[ego, at] - LENGTH
            closing = run.speed[ego, at] - (run.x[other, 1] - run.x[other, 0]) / (run.time[1] - run.time[0])
            if not (gap > 0.0 and closing > 0.0 and gap <= URGENT * closing):
                return any("Ego" in one.entities and one.time <= run.time[at] for one in run.collisions)
    return any("Ego" in one.entities for one in run.collisions)


def causes(file: str, name: str, rows: pd.DataFrame, other: npt.NDArray[np.bool_]) -> dict[str, int]:
    """Why scenarios end otherwise than their rows, by what the model does by itself."""
    crash = rows.crash.to_numpy() > 0
    itself = by_itself(file, name, rows).crash != crash
    flips = np.zeros(len(rows), dtype=np.bool_)
    if file != "deceleration":
        key = "gap_m" if file == "cut_in" else "front_gap_m"
        closing = rows.ego_kmh - rows.other_kmh if file == "cut_in" else rows.speed_kmh
        for share in (-1.0, -0.5, 0.5, 1.0):
            moved = rows.assign(**{key: rows[key] + share * closing / 3.6 * TIME_STEPS[0]})
            flips |= by_itself(file, name, moved).crash != by_itself(file, name, rows).crash
    return {
        "the model by itself differs, too": int((other & itself).sum()),
        "0.1 s of closing decide": int((other & ~itself & flips).sum()),
        "else": int((other & ~itself & ~flips).sum()),
    }


def compared(folder: Path, sample: int, seed: int, time_steps: tuple[float, ...]) -> list[dict[str, Any]]:
    """One row of figures for each file and model."""
    found = []
    for file in FILES:
        table = pd.read_csv(folder / f"{file}.csv")
        for model, rows in table.groupby("model"):
            name, crash = NAMES[str(model)], rows.crash.to_numpy() > 0
            outcome = by_itself(file, name, rows)
            figures: dict[str, Any] = {"file": file, "driver": name, "rows": len(rows)}
            figures["same outcome"] = float((outcome.crash == crash).mean())
            if name == "fsm":
                same = np.abs(outcome.proactive - column(rows, "pfs")) <= 1e-6
                same &= np.abs(outcome.critical - column(rows, "cfs")) <= 1e-6
                figures["same metrics"] = float(same.mean())
            moving = rows[rows.lateral_m_s != 0.0] if file != "deceleration" else rows
            chosen = moving.sample(min(sample, len(moving)), random_state=seed)
            figures["run"] = len(chosen)
            for step in time_steps:
                simulator = Builtin(time_step=step, duration=35.0, drivers={"Ego": name})
                crashes = np.array(
                    [crashed(file, name, one) for one in simulator.run(as_scenarios(file, name, chosen))]
                )
                figures[f"same in steps of {step} s"] = float((crashes == (chosen.crash.to_numpy() > 0)).mean())
                figures[f"why not, in steps of {step} s"] = causes(
                    file, name, chosen, crashes != (chosen.crash.to_numpy() > 0)
                )
                figures[f"others, in steps of {step} s"] = {
                    "crash here alone": int((crashes & (chosen.crash.to_numpy() == 0)).sum()),
                    "crash there alone": int((~crashes & (chosen.crash.to_numpy() > 0)).sum()),
                }
            found.append(figures)
            print(", ".join(f"{key} {shown(value)}" for key, value in figures.items()), flush=True)
    return found


def shown(value: Any) -> str:
    return f"{value:.2%}" if isinstance(value, float) else str(value)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--r157", type=Path, required=True, metavar="FOLDER")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--sample", type=int, default=2000, metavar="N")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    sample, time_steps = (300, TIME_STEPS[:1]) if given.quick else (given.sample, TIME_STEPS)
    found = compared(given.r157, sample, given.seed, time_steps)
    if given.json is not None:
        given.json.write_text(json.dumps({"seed": given.seed, "agreement": found}, indent=2) + "\n")


if __name__ == "__main__":
    main()
