"""What programs read is as its JSON schema says; schemas name the keys one by one."""

from __future__ import annotations

import json
import shutil
from importlib import resources

import pytest
from jsonschema import Draft202012Validator

from helpers.command_line import SPACE, X, cornercase

SEARCH = ("explore", X, "--space", SPACE, "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--seed", "1")


def schema_of(name):
    return json.loads(resources.files("cornercase").joinpath("schemas", f"{name}.schema.json").read_bytes())


def validate(name, text):
    schema = schema_of(name)
    Draft202012Validator.check_schema(schema)
    found = json.loads(text)
    errors = [f"{one.json_path}: {one.message[:300]}" for one in Draft202012Validator(schema).iter_errors(found)]
    assert not errors, "\n".join(errors)
    return found


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("schemas")
    study = folder / "study.db"
    more = ("--metric", "trajectory-distance", "--optimizer", "sobol", "--budget", "24", "--audit", "0.25")
    for command in (
        (*SEARCH, *more, "--driver", "Ego=normal", "-o", study),
        ("analyze", study),
        ("reduce", study, "--scenario", X, "--size", "4", "--kill-mutants", "2", "-o", folder / "reduced"),
    ):
        assert cornercase(*command).returncode == 0
    return folder


def test_show(folder):
    found = validate("show", cornercase("show", folder / "study.db", "--json").stdout)
    assert found["metrics"]["trajectory-distance"]["critical_is"] == "low"
    assert found["critical"]["audit"]["scenarios"] == 6
    asked = validate("show", cornercase("show", folder / "study.db", "--critical", "0.1", "--json").stdout)
    assert asked["critical"]["asked"]
    # Names stay as they are; the rest are identifiers.
    assert set(found["clusters"]) >= {"ego-trajectory", "trajectory-distance"}
    assert all(key.isidentifier() for key in (*found, *found["critical"], *found["sensitivity"]))


@pytest.mark.parametrize(
    "options",
    [
        ("--metric", "distance", "--pareto", "--optimizer", "random", "--asynchronous"),
        ("--critical-if", "collision and not reference:cautious", "--optimizer", "random"),
        ("--optimizer", "random", "--repeats", "2", "--max-repeats", "5"),
        ("--optimizer", "random", "--other", "C"),
    ],
)
def test_show_of_other_searches(options, tmp_path):
    assert cornercase(*SEARCH, *options, "--budget", "3", "-o", tmp_path / "study.db").returncode == 0
    validate("show", cornercase("show", tmp_path / "study.db", "--json").stdout)


def test_manifest_and_test(folder, tmp_path):
    manifest = validate("manifest", (folder / "reduced" / "manifest.json").read_text(encoding="utf-8"))
    assert manifest["exposing"]["chosen_by"]["mutants"] == 2
    run = ("test", folder / "reduced", "--require", "no collision", "--require", "wttc > 5", "--json")
    found = validate("test", cornercase(*run, "--mutants", "2", "-o", tmp_path / "run.db").stdout)
    assert found["failed"] > 0
    assert len(found["mutants"]["by_mutant"]) == 2


def test_manifest_of_chosen_scenarios(folder, tmp_path):
    assert cornercase("reduce", folder / "study.db", "--ids", "1-3", "-o", tmp_path / "chosen").returncode == 0
    manifest = validate("manifest", (tmp_path / "chosen" / "manifest.json").read_text(encoding="utf-8"))
    assert [one["role"] for one in manifest["scenarios"]] == ["chosen"] * 3


def test_a_manifest_of_the_first_format_is_run(folder, tmp_path):
    shutil.copytree(folder / "reduced", tmp_path / "reduced")
    file = tmp_path / "reduced" / "manifest.json"
    plain = json.loads(file.read_text(encoding="utf-8"))
    plain["critical threshold"] = plain.pop("critical_threshold")
    file.write_text(json.dumps(plain | {"format": 1}), encoding="utf-8")
    done = cornercase("test", tmp_path / "reduced", "--json", "-o", tmp_path / "run.db")
    assert done.returncode in (0, 1), done.stderr
    validate("test", done.stdout)


def test_estimate(folder, tmp_path):
    run = ("estimate", folder / "study.db", "--scenario", X, "--budget", "100", "-o", tmp_path / "estimate.db")
    found = validate("estimate", cornercase(*run, "--json").stdout)
    assert found["scenarios"] == 100
    shown = validate("show", cornercase("show", tmp_path / "estimate.db", "--json").stdout)
    assert shown["probability"] == found


def test_a_probability_is_described_once():
    """Each schema holds all that it needs, so that a validator takes it alone; both say the same."""
    show, estimate = schema_of("show"), schema_of("estimate")
    name = "probability_of_an_event"
    assert show["$defs"][name] == estimate["$defs"][name]
    assert show["properties"]["probability"]["properties"] == estimate["properties"]
    assert (
        json.dumps(show).count('"effective_number_met":') == json.dumps(estimate).count('"effective_number_met":') == 1
    )


def test_compare(folder, tmp_path):
    new = tmp_path / "new.db"
    more = ("--metric", "trajectory-distance", "--optimizer", "sobol", "--budget", "24", "--audit", "0.25")
    assert cornercase(*SEARCH, *more, "--driver", "Ego=aggressive", "-o", new).returncode == 0
    found = validate("compare", cornercase("compare", folder / "study.db", new, "--json").stdout)
    assert found["changed"]
    assert found["changed_pairs"]
    assert found["space"]["gained"]
    assert found["verdict"] in ("worse", "better", "mixed")
    assert found["worse"] or found["better"]
    same = validate("compare", cornercase("compare", folder / "study.db", folder / "study.db", "--json").stdout)
    assert not same["changed"]
    assert same["verdict"] == "the same"


def test_compare_of_suites(folder, tmp_path):
    for name, driver in (("old", "normal"), ("new", "aggressive")):
        run = ("test", folder / "reduced", "--driver", f"Ego={driver}", "--require", "wttc > 0.3")
        assert cornercase(*run, "-o", tmp_path / f"{name}.db").returncode in (0, 1)
    found = validate("compare", cornercase("compare", tmp_path / "old.db", tmp_path / "new.db", "--json").stdout)
    assert found["verdicts"]


def test_verify(folder, tmp_path):
    study = tmp_path / "study.db"
    shutil.copy(folder / "study.db", study)
    assert validate("verify", cornercase("verify", study, "--json").stdout)["sound"]
