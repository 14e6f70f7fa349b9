"""Files that a stranger could have sent."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

from conftest import car, scenario_file, speed_action, teleport
from cornercase import analyze, explore, reduce
from helpers.checksums import changed

SPEED = '<ParameterDeclaration name="v" parameterType="double" value="10"/>'


def whole_study(folder):
    """A study of a following car that was explored, analysed and reduced; its scenario file lies beside it."""
    folder.mkdir(parents=True, exist_ok=True)
    init = "".join(
        f'<Private entityRef="{name}">{teleport(s)}{speed_action(v)}</Private>'
        for name, s, v in (("Ego", "10", "$v"), ("B", "60", "8"))
    )
    scenario = scenario_file(folder, init=init, parameters=SPEED, entities=car("Ego") + car("B"))
    study = folder / "s.db"
    explore(
        scenario, study, ego="Ego", other="B", metrics=["distance", "ttc"], ranges=["v=5:20"], optimizer="sobol",
        budget=12, duration=4.0, time_step=0.2,
    )  # fmt: skip
    analyze(study)
    reduce(study, folder / "reduced", size=4)
    return study


def copied(study, folder):
    """A study, and its scenario, in another folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("s.db", "scenario.xosc", "road.xodr"):
        shutil.copy(study.parent / name, folder / name)
    return folder / "s.db"


def change(study: Path, *statements):
    """Change a study as one who does not use cornercase, but makes its checksums: SQL, or (SQL, values)."""
    changed(study, *statements)


def set_meta(study, **values):
    change(study, *(("UPDATE meta SET value = ? WHERE key = ?", (json.dumps(v), k)) for k, v in values.items()))
