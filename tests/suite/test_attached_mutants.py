"""Mutants of FMUs and programs, whose mutations a file declares."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import pytest

from cornercase._common.errors import InputError
from cornercase.drivers import FmuDriver, ProcessFunction, generate_mutants
from cornercase.drivers import process as process_package
from cornercase.drivers._mutants import mutable_driver_name
from helpers.command_line import cornercase
from helpers.fmus import make_fmu
from helpers.isolation import ROOT

DECELERATION = ROOT / "examples" / "r157" / "deceleration.xosc"
PROGRAM = f'exec:"{sys.executable}" aeb.py'
MUTATIONS = """
[time_to_brake]
description = "brakes later"
factor = [0.9, 0.2]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    shutil.copy(ROOT / "examples" / "process" / "aeb.py", tmp_path)
    shutil.copy(Path(process_package.__file__).with_name("cornercase_client.py"), tmp_path)
    (tmp_path / "program.toml").write_text(MUTATIONS)
    (tmp_path / "fmu.toml").write_text("[reaction]\nincrease = [0.2, 1.5]\n")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_program_has_mutants_by_its_file_through_the_commands(folder):
    driver = f"Ego={PROGRAM}:time_to_brake=2"
    done = cornercase(
        "-q", "explore", DECELERATION, "--range", "gap=15:60", "--ego", "Ego", "--other", "Other", "--metric", "ttc",
        "--optimizer", "sobol", "--budget", 3, "--duration", 8, "--sut", driver, "-o", "s.db", cwd=folder,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert cornercase("-q", "analyze", "s.db", "--by", "ttc", cwd=folder).returncode == 0
    selected = ("-q", "reduce", "s.db", "--size", 1, "--kill-mutants", 2, "-o", "reduced", "--sut")
    unknown = cornercase(*selected, driver, cwd=folder)
    assert unknown.returncode == 2
    assert "no file says how far its parameters may be off; give such a file" in unknown.stderr
    # The study was explored without the file, and is that of the same program.
    done = cornercase(*selected, f"{driver},mutations=program.toml", cwd=folder)
    assert done.returncode == 0, done.stderr
    tested = cornercase(
        "test",
        "reduced",
        "--mutants",
        2,
        "--sut",
        f"{driver},mutations=program.toml",
        "--json",
        "-o",
        "run.db",
        cwd=folder,
    )
    assert tested.returncode == 0, tested.stderr
    mutants = json.loads(tested.stdout)["mutants"]
    assert "brakes later" in json.dumps(mutants)


def test_an_fmu_has_mutants_by_its_file(folder):
    make_fmu(folder / "aeb.fmu")
    mutants = generate_mutants("fmu:aeb.fmu:mutations=fmu.toml + kinematic", 3)
    assert {mutant.mutation for mutant in mutants} == {"other reaction"}
    for mutant in mutants:
        spec, _, equipment = mutant.driver.partition(" + ")
        assert equipment == "kinematic"
        assert 0.3 <= float(spec.rpartition("reaction=")[2]) <= 1.6
    # A whole number that is rounded to the driver's own makes no mutant.
    (folder / "fault.toml").write_text("[fault]\nincrease = [0.1, 2]\n")
    mutants = generate_mutants("fmu:aeb.fmu:mutations=fault.toml", 4)
    assert {mutant.driver.rpartition("fault=")[2] for mutant in mutants} == {"1", "2"}
    assert mutable_driver_name(FmuDriver("aeb.fmu", mutations="fmu.toml")) == "fmu:aeb.fmu:mutations=fmu.toml"
    assert str(FmuDriver("aeb.fmu", mutations="fmu.toml")) == "fmu:aeb.fmu"
    given = ProcessFunction(PROGRAM.removeprefix("exec:"), time_to_brake=2, mutations="program.toml")
    assert str(given) == f"{PROGRAM}:time_to_brake=2"
    assert mutable_driver_name(given) == f"{PROGRAM}:mutations=program.toml,time_to_brake=2"


@pytest.mark.parametrize(
    "name", [f"{PROGRAM}:time_to_brake=2,mutations=program.toml", "fmu:aeb.fmu:mutations=fmu.toml"]
)
def test_a_text_that_a_study_or_file_may_hold_runs_nothing(folder, name):
    make_fmu(folder / "aeb.fmu")
    with pytest.raises(InputError, match="has no mutants, as its parameters are unknown"):
        mutable_driver_name(name)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "has no table; write one for each option, as in [reaction]"),
        ("reaction = 2", "[reaction]: is no table"),
        ("[reaction]\nfactr = [1, 2]", "'factr', which is not known; did you mean 'factor'?"),
        ("[reaction]", "needs either factor = [0.8, 0.2] or increase"),
        ("[reaction]\nfactor = [1, 2]\nincrease = [1, 2]", "needs either factor"),
        (
            "[reaction]\nfactor = [1, 0]",
            "[reaction], factor: give two numbers from 1e-06 to 1e+06, from mild to severe",
        ),
        ("[reaction]\nfactor = 2", "give two numbers from"),
        ("[reaction]\nfactor = [1, 2]\ndescription = 3", "description: give a text"),
        ("[reacton]\nfactor = [1, 2]", "has no numeric parameter 'reacton'; did you mean 'reaction'?"),
    ],
)
def test_a_wrong_file_is_refused_with_its_table(folder, text, says):
    make_fmu(folder / "aeb.fmu")
    (folder / "wrong.toml").write_text(text)
    with pytest.raises(InputError) as refused:
        generate_mutants("fmu:aeb.fmu:mutations=wrong.toml", 3)
    assert says in str(refused.value)
