"""Suites, requirements and options that cannot be used, and files that are written over nothing else."""

from __future__ import annotations

import json
import os
import shutil
import sqlite3
import sys
from contextlib import closing

import pytest

import cornercase as cc
from cornercase._common.errors import InputError
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.scenario._types import format_value


def test_no_verdicts_of_another_run_are_left_where_nothing_can_be_run(reduced, tmp_path):
    cc.run_suite(reduced, tmp_path / "earlier.db", junit=tmp_path / "out.xml", summary=tmp_path / "out.md")
    with pytest.raises(cc.InputError):
        cc.run_suite(reduced, tmp_path / "run.db", junit=tmp_path / "out.xml", drivers={"Ego": "gone:Driver"})
    with pytest.raises(cc.InputError):
        cc.run_suite(reduced, tmp_path / "run.db", junit=tmp_path / "out.xml", simulator="carla:port=1")
    assert not (tmp_path / "out.xml").exists()


@pytest.mark.parametrize("option", ["junit", "summary"])
def test_nothing_else_is_written_over(option, reduced, tmp_path):
    junit = "<?xml version='1.0' encoding='utf-8'?>\n<testsuites name=\"unit tests\"/>\n"
    for name, text in (("mine.py", "# Kept\n"), ("README.md", "### My notes\n"), ("ci.xml", junit), ("later.db", "?")):
        (tmp_path / name).write_text(text)
        with pytest.raises(cc.InputError, match="exists and is not from an earlier run"):
            cc.run_suite(reduced, tmp_path / "run.db", **{option: tmp_path / name})
        assert (tmp_path / name).read_text() == text
    # GitHub makes an empty one.
    (tmp_path / "own").write_text("")
    for _ in range(2):
        cc.run_suite(reduced, tmp_path / "run.db", **{option: tmp_path / "own"})
        assert (tmp_path / "own").read_text()


def spoilt(folder, **changes):
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    for name, value in changes.items():
        if value is None:
            del manifest[name]
        else:
            manifest[name] = value
    path.write_text(json.dumps(manifest))


def spoilt_value(folder, values):
    scenarios = json.loads((folder / "manifest.json").read_text())["scenarios"]
    spoilt(folder, scenarios=[{**scenarios[0], "values": values}, *scenarios[1:]])


def spoilt_twice(folder):
    scenarios = json.loads((folder / "manifest.json").read_text())["scenarios"]
    spoilt(folder, scenarios=[*scenarios, scenarios[0]])


BAD = {
    "a file is gone": (lambda f: next(f.glob("*.xosc")).unlink(), "is not there; restore it"),
    "a file has changed": (lambda f: next(f.glob("*.xosc")).write_bytes(b"<OpenSCENARIO/>"), "has changed since"),
    "the road has changed": (lambda f: next(f.glob("*.xodr")).write_bytes(b"<OpenDRIVE/>"), "has changed since"),
    "another format": (lambda f: spoilt(f, format=3), "has the format 3"),
    "an early version": (lambda f: spoilt(f, format=None), "an earlier version of cornercase wrote it"),
    "imported": (lambda f: spoilt(f, simulator="imported"), "was made from imported recordings"),
    "options of a stranger": (lambda f: spoilt(f, simulator="esmini:library=evil.so"), "and these options could run programs; give `simulator`"),
    "a file elsewhere": (lambda f: spoilt(f, files={"../../secret": "0"}), "is not a file in its folder"),
    "no JSON": (lambda f: (f / "manifest.json").write_text("{"), "is not valid JSON"),
    "a study": (lambda f: (f / "manifest.json").write_bytes(b"SQLite format 3\0\xea"), "is a study; run `reduce` first"),
    "no manifest": (lambda f: (f / "manifest.json").write_text("[]"), "is not a manifest"),
    "half a character": (lambda f: spoilt(f, study="\ud800.db"), "holds half a character"),
    "nothing in it": (lambda f: spoilt(f, space=None), "cannot be used as a manifest"),
    "no texts": (lambda f: spoilt(f, ego=3), "cannot be used as a manifest"),
    "a driver of somebody's own": (
        lambda f: spoilt(f, settings={"drivers": {"Ego": {"class": "Mine"}}}), "give the driver, as in {'Ego': 'normal'}",
    ),
    "values of nothing": (lambda f: spoilt_value(f, {}), "do not fit its parameter space"),
    "values that are too large": (lambda f: spoilt_value(f, {"ego_speed_mps": 10**400}), "manifest.json: "),
    "an unknown metric": (lambda f: spoilt(f, metrics=["tcc"]), "manifest.json names the metric 'tcc', which cornercase does not have"),
    "no time step": (lambda f: spoilt(f, settings={"time_step": 0}), "manifest.json: time_step 0: choose"),
    "no duration at all": (lambda f: spoilt(f, settings={"duration": 10**400}), "manifest.json: duration"),
    "a name without end": (lambda f: spoilt(f, files={"x" * 300: "0"}), "names a file that cannot be read"),
    "a scenario twice": (lambda f: spoilt_twice(f), "names a file twice"),
    "no scenarios": (lambda f: [one.unlink() for one in f.iterdir()], "has no scenarios"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_a_suite_that_cannot_be_used_is_refused_in_a_sentence(case, reduced, tmp_path):
    spoil, words = BAD[case]
    spoil(reduced)
    with pytest.raises(cc.InputError) as error:
        cc.run_suite(reduced, tmp_path / "run.db")
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert not (tmp_path / "run.db").exists()


def test_42_2_values_that_the_file_does_not_have_are_refused(reduced, tmp_path):
    first = json.loads((reduced / "manifest.json").read_text())["scenarios"][0]
    name, value = next(iter(first["values"].items()))
    spoilt_value(reduced, first["values"] | {name: value + 0.25})
    with pytest.raises(cc.InputError) as error:
        cc.run_suite(reduced, tmp_path / "run.db")
    assert str(error.value) == (
        f"{reduced / 'manifest.json'}: gives {first['file']} the value {value + 0.25} for the parameter '{name}', but that file declares"
        f" {format_value(value)}; run `reduce` again."
    )
    assert not (tmp_path / "run.db").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"require": ["ttc > 1.5 m"]}, "unit 'm' does not fit"),
        ({"require": ["tcc > 1.5"]}, "ttc"),
        ({"require": ["no collision with Pedestrian"]}, "has no entity 'Pedestrian'"),
        ({"require": ["no collision with Ego"]}, "names the ego itself"),
        ({"require": ['for "\\ud800": no collision']}, "is empty or not quoted as in JSON"),
        ({"require": ["no collision with \udcff"]}, "holds half a character"),
        ({"require": ["for x*.xosc: no collision"]}, "no file of"),
        ({"metrics": ["tcc"]}, "did you mean 'ttc'"),
        ({"drivers": {"Ego": "agressive"}}, "did you mean 'aggressive'"),
        ({"drivers": {"Egon": "aggressive"}}, "has no entity 'Egon'"),
        ({"other": "Ego"}, "is the ego itself"),
        ({"simulator": "builtn"}, "did you mean 'builtin'"),
        ({"on_collision": "halt"}, "on_collision"),
    ],
)
def test_options_that_cannot_be_used_are_refused_in_a_sentence(options, words, explored, tmp_path):
    with pytest.raises(cc.InputError) as error:
        cc.run_suite(explored / "reduced", tmp_path / "run.db", **options)
    assert words in str(error.value)
    assert not (tmp_path / "run.db").exists()


def test_junit_is_written_over_nothing_that_is_read_or_written(reduced, tmp_path):
    rules = tmp_path / "rules.toml"
    rules.write_text('require = ["no collision"]')
    taken = [rules, tmp_path / "study.db", reduced / "manifest.json", *reduced.glob("*.xo*")]
    before = [one.read_bytes() for one in taken]
    for junit in [*taken, tmp_path / "run.db", tmp_path / "run.db.lock", tmp_path, tmp_path / "rules.toml" / "x.xml"]:
        with pytest.raises(cc.InputError, match="`junit`"):
            cc.run_suite(reduced, tmp_path / "run.db", requirements=rules, junit=junit)
        with pytest.raises(cc.InputError, match="`summary`"):
            cc.run_suite(reduced, tmp_path / "run.db", requirements=rules, summary=junit)
    with pytest.raises(cc.InputError, match=r"`summary` .*is the JUnit file too"):
        cc.run_suite(reduced, tmp_path / "run.db", junit=tmp_path / "out", summary=tmp_path / "out")
    assert [one.read_bytes() for one in taken] == before
    # Not after an hour of simulations.
    assert not (tmp_path / "run.db").exists()


def test_a_file_of_requirements_is_named_where_one_of_it_is_none(explored, tmp_path):
    (tmp_path / "rules.toml").write_text('require = ["tcc > 1"]')
    with pytest.raises(cc.InputError, match=r"rules\.toml: .*ttc"):
        cc.run_suite(explored / "reduced", tmp_path / "run.db", requirements=tmp_path / "rules.toml")


@pytest.mark.skipif(sys.platform != "linux", reason="names are text there")
def test_a_name_that_is_no_text_is_refused(reduced, tmp_path):
    (reduced / "manifest.json").unlink()
    source = next(reduced.glob("*.xosc"))
    shutil.copy(source, os.fsencode(reduced) + b"/bad\xff.xosc")
    with pytest.raises(cc.InputError, match="is not UTF-8; rename"):
        cc.run_suite(reduced, tmp_path / "run.db", ego="Ego", other="C")


def test_an_origin_that_is_named_has_to_be_one(explored, tmp_path):
    other = tmp_path / "other.db"
    explore_config(paper_experiment_config("x-intersection", budget=2), other)
    with pytest.raises(cc.InputError, match="is not the study that"):
        cc.run_suite(explored / "reduced", tmp_path / "run.db", against=other)
    with pytest.raises(cc.InputError, match="is the input file"):
        cc.run_suite(explored / "reduced", explored / "study.db")


def test_a_damaged_study_to_compare_with_is_told_before_anything_is_run(reduced, tmp_path):
    with closing(sqlite3.connect(tmp_path / "study.db")) as connection, connection:
        connection.execute("UPDATE courses SET score = score + 1")
    with pytest.raises(cc.InputError, match="wrong checksum"):
        cc.run_suite(reduced, tmp_path / "run.db", against=tmp_path / "study.db")
    assert not (tmp_path / "run.db").exists()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("require = 'no collision'", "is not a list of texts"),
        ("requires = ['no collision']", "did you mean 'require'"),
        ("require = [", "is not valid TOML"),
        ("", "holds no requirement"),
        ("[for]\n'a: b' = ['no collision']", "no file of"),
        ("[for]\n' ' = ['no collision']", "is not a pattern of file names"),
        ("[kind]\n'no such *' = ['no collision']", "belongs to such a cluster; the clusters are "),
        (
            "kind = ['no collision']",
            "'kind' is not a table with a list of requirements for each pattern of names of kinds",
        ),
    ],
)
def test_files_of_requirements_that_cannot_be_used_are_refused(content, words, explored, tmp_path):
    (tmp_path / "r.toml").write_text(content)
    with pytest.raises(cc.InputError) as error:
        cc.run_suite(explored / "reduced", tmp_path / "run.db", requirements=tmp_path / "r.toml")
    assert words in str(error.value)


@pytest.mark.parametrize(
    ("requirement", "words"),
    [
        ("no collision unless cautios collides", "did you mean 'cautious'"),
        ("no collision unless cautious", "give a driver, as in 'no collision unless"),
        ("no collision unless collides", "give a driver, as in 'no collision unless"),
    ],
)
def test_a_reference_that_is_not_there_is_named_before_anything_is_run(explored, tmp_path, requirement, words):
    with pytest.raises(InputError) as refused:
        cc.run_suite(explored / "reduced", tmp_path / "run.db", require=[requirement])
    assert words in str(refused.value)
    assert not (tmp_path / "run.db").exists()
