"""The results of three small studies, number by number: they stay the same while the code around them changes.

``python tests/test_golden.py`` writes the present results to ``tests/data/golden.json``. Whoever does that says in the
commit which defect or feature changed them.
"""

from __future__ import annotations

import csv
import json
import tempfile
from pathlib import Path

import pytest
from typer.testing import CliRunner

from cornercase import LogicalScenario
from cornercase.cli import app

GOLDEN = Path(__file__).parent / "data" / "golden.json"
NCAP = Path(__file__).parents[2] / "shared" / "reference" / "openscenario" / "ncap" / "OpenSCENARIO" / "NCAP"
SPACE = NCAP / "CA-FC_2026" / "Variations" / "StandardRange" / "CPNCO.xosc"

STUDIES = ("x-intersection", "t-intersection", "cpnco")


def run(*arguments) -> str:
    result = CliRunner().invoke(app, [str(one) for one in arguments])
    assert result.exit_code == 0, result.output
    return result.stdout


def results(name: str, folder: Path) -> dict[str, object]:
    """What the command line tells of a study of 60 scenarios with seed 1, without paths and times."""
    study = folder / "study.db"
    if name == "cpnco":
        run(
            "explore", "--space", SPACE, "--range", "Ego_speed_kph=10:60", "--ego", "Ego", "--other", "VRU",
            "--metric", "wttc", "--metric", "distance", "--driver", "Ego=normal", "--optimizer", "level-set",
            "--critical", "0.4", "--budget", "60", "--seed", "1", "-o", study,
        )  # fmt: skip
        run("analyze", study)
        scenario = LogicalScenario.read(None, SPACE).scenario.path
        run("reduce", study, "--scenario", scenario, "-o", folder / "reduced")
    else:
        run("demo", name, "--budget", "60", "--seed", "1", "-o", folder)
    run("export", study, "-o", folder / "export")
    summary = json.loads(run("show", study, "--json"))
    manifest = json.loads((folder / "reduced" / "manifest.json").read_text())
    for one, keys in ((summary, ("scenario", "seconds")), (manifest, ("scenario",))):
        for key in keys:
            del one[key]
    with open(folder / "export" / "scenarios.csv", newline="") as file:
        scenarios = list(csv.reader(file))
    return {"summary": summary, "manifest": manifest, "scenarios": scenarios}


def same(found: object, held: object, place: str) -> None:
    """Numbers may differ in their last digits, as machines do; more where a surrogate was fitted by gradients."""
    loose = 1e-4 if "/critical/" in place else 1e-6
    if isinstance(held, dict):
        assert isinstance(found, dict), place
        assert list(found) == list(held), place
        for key, value in held.items():
            same(found[key], value, f"{place}/{key}")
    elif isinstance(held, list):
        assert isinstance(found, list), place
        assert len(found) == len(held), place
        for k, value in enumerate(held):
            same(found[k], value, f"{place}/{k}")
    elif isinstance(held, float):
        assert found == pytest.approx(held, rel=loose, abs=1e-9), place
    elif isinstance(held, str) and is_number(held):
        assert isinstance(found, str), place
        assert is_number(found), place
        assert float(found) == pytest.approx(float(held), rel=loose, abs=1e-9), place
    else:
        assert found == held, place


def is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


@pytest.mark.parametrize("name", STUDIES)
def test_results_are_what_they_were(name, tmp_path):
    if name == "cpnco" and not SPACE.exists():
        pytest.skip("Euro NCAP's files are not beside the checkout")
    same(results(name, tmp_path), json.loads(GOLDEN.read_text())[name], name)


if __name__ == "__main__":
    held = {}
    for name in STUDIES:
        with tempfile.TemporaryDirectory() as folder:
            held[name] = results(name, Path(folder))
    GOLDEN.write_text(json.dumps(held, indent=1) + "\n")
