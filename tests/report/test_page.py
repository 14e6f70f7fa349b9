"""What the file of a page holds: the study, its recordings, and nothing that a name in it could run."""

from __future__ import annotations

import base64
import io
import json
import math
import re
import shlex
import zlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, at_night
from cornercase._common.errors import InputError, SimulationError
from cornercase._common.memory import MemoryLimit
from cornercase._common.version import __version__
from cornercase.clustering import analyze
from cornercase.metrics.ending._find_outcome import find_outcome
from cornercase.recordings import Collision, Recording
from cornercase.recordings._compact_encoding import encode_rounded
from cornercase.reduction import reduce
from cornercase.reduction._write_files import write_chosen_scenarios
from cornercase.report import summarize, write_report
from cornercase.report._metric_courses import encode_courses
from cornercase.report._one_page_summary import write_one_page_summary
from cornercase.report._repeat_command import format_repeat_command
from cornercase.report._report_data import read_report_data
from cornercase.report._rerun import render_concrete_scenario, rerun_payload
from cornercase.report.encode import _page_recordings as page_recordings
from cornercase.report.html._cluster_sections import render_clusterings
from cornercase.report.text._answers import page_answers
from cornercase.report.text._phrases import format_percent, format_value
from cornercase.report.text._summary_dict import summary_to_dict
from cornercase.scenario import Parameter, ParameterSpace
from cornercase.study import StudyFile, import_recordings
from cornercase.study._scenario_digest import COURSE_POINTS
from cornercase.study._scenario_file import find_explored_scenario
from helpers.command_line import cornercase
from helpers.joint_values import joint_values
from helpers.synthetic_study import SPACE, Synthetic, about, explorer, opened
from helpers.two_cars import met

# As `explorer` searches, so that the study knows which scenarios fill the space.
BY_SOBOL = {"optimizer": "sobol", "seed": 7}
STEPS = {"time": 1e-4, "x": 1e-3, "y": 1e-3, "heading": 1e-4, "speed": 1e-3, "acceleration": 1e-3, "course": 1e-4}


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    """A study with scenarios that failed, a threshold, clusters and a reduced set."""
    path = tmp_path_factory.mktemp("page") / "s.db"
    with StudyFile.create(path, about(SPACE, "distance", "wttc", critical=1.0, **BY_SOBOL)) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
    analyze(path, "distance", gamma=4.0, eps=0.2, min_samples=3)
    return path


def known_of(study):
    """What is known of all critical scenarios."""
    critical = summarize(study).estimates.critical
    assert critical is not None
    assert critical.critical_set is not None
    return critical.critical_set


@pytest.fixture(scope="module")
def page(path, tmp_path_factory):
    """The page of the study, which is written once."""
    return page_of(path, tmp_path_factory.mktemp("written"))


@pytest.fixture(scope="module")
def data(path):
    with StudyFile.open(path, readonly=True) as study:
        return read_report_data(study)


@pytest.fixture(scope="module")
def known(path):
    with StudyFile.open(path, readonly=True) as study:
        return known_of(study)


def contents_of(page):
    (text,) = re.findall(r'<script type="application/json" id="contents">(.*?)</script>', page, re.DOTALL)
    return json.loads(text)


def page_of(study, folder, **options):
    return write_report(study, folder / "r.html", **options).read_text(encoding="utf-8")


def unpacked(page, scenario):
    """A recording of a page, read as the docstring of `encode_rounded` says."""
    assert scenario in contents_of(page)["recordings"]
    (text,) = re.findall(f'class="recordings" data-id="{scenario}">([^<]*)<', page)
    return read_record(zlib.decompress(base64.b64decode(text)))


def read_record(data):
    stream = io.BytesIO(data)
    head = json.loads(stream.read(int.from_bytes(stream.read(4), "little")))
    rows, instants = sum(count for _, count, _, _ in head["fields"]), head["instants"]

    def table(dtype, rows, columns):
        content = stream.read(np.dtype(dtype).itemsize * rows * columns)
        return np.frombuffer(content, dtype).reshape(rows, columns).astype(np.int32)

    there = table("u1", rows, instants) if head["gaps"] else np.ones((rows, instants))
    starts, rates = table("<i4", rows, 1), table("<i4", rows, min(instants - 1, 1))
    found, row = {}, 0
    for name, count, step, width in head["fields"]:
        mine = slice(row, row + count)
        changes = table(f"<i{width}", count, max(instants - 2, 0))
        rate = np.cumsum(np.hstack((rates[mine], changes)), axis=1, dtype=np.int32)
        whole = np.cumsum(np.hstack((starts[mine], rate)), axis=1, dtype=np.int32)
        values = whole * step + head["origin"].get(name, 0.0)
        found[name] = np.where(there[mine] == 1, values, np.nan)
        row += count
    assert not stream.read()
    return head, found


def test_each_scenario_of_the_study_is_in_the_contents(path, page):
    contents = contents_of(page)
    with StudyFile.open(path, readonly=True) as study:
        rows, table, labels = study.rows(), study.table(), study.read_analysis("distance", "labels")[0]["labels"]
    columns = contents["scenarios"]
    assert columns["id"] == [row.id for row in rows]
    assert columns["round"] == [row.round for row in rows]
    assert columns["failed"] == [int(row.state == "failed") for row in rows]
    assert sum(columns["failed"]) > 0
    for parameter, values in zip(contents["parameters"], columns["values"], strict=True):
        assert values == [row.values[parameter["name"]] for row in rows]
    for name in ("distance", "wttc"):
        expected = [None if math.isnan(score) else float(f"{score:.6g}") for score in table[name].tolist()]
        assert columns["scores"][name] == expected
    assert columns["critical"] == [int(score <= 1.0) for score in table["distance"]]
    assert contents["errors"] == {str(row.id): row.error for row in rows if row.state == "failed"}
    kinds = contents["kinds"]["distance"]
    assert [label for label in kinds["labels"] if label is not None] == labels.tolist()
    outcomes = [contents["outcomes"][one] for one in columns["outcome"] if one is not None]
    assert outcomes == table["outcome"].dropna().tolist()


def test_the_search_is_told_round_by_round(path, page, known):
    told = contents_of(page)["search"]
    with StudyFile.open(path, readonly=True) as study:
        rounds, scores = [row.round for row in study.finished_rows()], study.scores("distance")
    assert told["run"] == [sum(one <= last for one in rounds) for last in sorted(set(rounds))]
    assert told["best"] == [float(f"{scores[:run].min():.5g}") for run in told["run"]]
    assert told["critical"] == [int((scores[:run] <= 1.0).sum()) for run in told["run"]]
    assert [one["run"] for one in told["missed"]] == sorted({one["run"] for one in told["missed"]})
    assert {one["run"] for one in told["missed"]} <= set(told["run"])
    assert told["missed"][-1]["run"] == len(scores)
    assert told["missed"][-1]["value"] == pytest.approx(known.missed_fraction.value, rel=1e-4)
    assert len(told["missed"]) > 1


def test_what_was_missed_at_a_round_is_as_it_would_have_been_told_then(page, tmp_path):
    told = contents_of(page)["search"]["missed"][0]
    with StudyFile.create(tmp_path / "short.db", about(SPACE, "distance", "wttc", critical=1.0, **BY_SOBOL)) as study:
        last = 10 * round(told["run"] / 9)
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=last).run()
        assert len(study.finished_rows()) == told["run"]
        known = known_of(study)
    assert told["value"] == pytest.approx(known.missed_fraction.value, rel=1e-4)


def test_recordings_are_read_back(path, page):
    with StudyFile.open(path, readonly=True) as study:
        assert set(contents_of(page)["recordings"]) == {row.id for row in study.finished_rows()}
        for scenario in [row.id for row in study.finished_rows()][::7]:
            head, found = unpacked(page, scenario)
            recording = study.recording(scenario)
            assert tuple(head["names"]) == recording.names
            for name in ("x", "y", "heading", "speed", "acceleration"):
                np.testing.assert_allclose(found[name], getattr(recording, name), atol=STEPS[name])
            np.testing.assert_allclose(found["time"][0], recording.time, atol=STEPS["time"])
            np.testing.assert_allclose(
                found["course distance"][0], study.course(scenario, "distance"), atol=STEPS["course"]
            )


def test_a_recording_far_away_with_gaps_is_read_back_to_the_millimetre():
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.01, 0.1, 200))
    walk = np.cumsum(rng.normal(size=(3, 200)), axis=1)
    x, heading = 5.4e6 + walk, np.cumsum(walk, axis=1) / 50.0
    x[1, 40:90] = heading[1, 40:90] = np.nan
    recording = Recording(
        time=time, names=("Ego", "歩行者", "</script>"), object_types=("car", "pedestrian", "misc"), x=x, y=-x, heading=heading,
        speed=np.abs(walk), acceleration=walk, length=np.full(3, 4.5), width=np.full(3, 1.8), center_x=np.full(3, 1.3),
        collisions=(Collision(float(time[7]), ("Ego", "</script>")),),
    )  # fmt: skip
    course = np.where(time > 3.0, np.inf, time)
    head, found = read_record(zlib.decompress(encode_rounded(recording, {"ttc": course})))
    for name in ("x", "y", "heading", "speed", "acceleration"):
        np.testing.assert_allclose(found[name], getattr(recording, name), atol=STEPS[name])
    np.testing.assert_allclose(found["course ttc"][0], np.where(np.isinf(course), np.nan, course), atol=1e-4)
    assert head["collisions"] == [[float(time[7]), 0, 2]]
    assert head["names"][1] == "歩行者"


@pytest.mark.parametrize("n_instants", [1, 2, 3])
def test_a_recording_of_few_instants_is_read_back(n_instants):
    x = np.arange(5.0, 5.0 + n_instants) ** 3
    recording = met((x, 0.0, 0.0, 3.0), (-x, 1.0, np.nan, 3.0))
    head, found = read_record(zlib.decompress(encode_rounded(recording, {})))
    assert head["gaps"]
    for name in ("x", "y", "heading", "speed", "acceleration"):
        np.testing.assert_allclose(found[name], getattr(recording, name), atol=STEPS[name])


def test_a_page_that_would_be_too_large_keeps_the_recordings_that_tell_most(path, page, data):
    with StudyFile.open(path, readonly=True) as study:
        packed = page_recordings.encode_important_recordings(
            study, data, max_characters=1000, sample_characters=6000, n_most_critical=2
        )
        examples = {one.example for one in summarize(study).analyses["distance"].profiles if one.example is not None}
        worst = study.finished_rows()[int(study.scores("distance").argmin())].id
        run = len(study.finished_rows())
    there = set(packed)
    assert examples | {worst} <= there
    assert len(there) < run
    assert f"{len(there)} of the {run} recordings" in page_recordings.describe_left_out_recordings(data, packed)
    assert contents_of(page)["recordings_left_out"] == ""


def test_a_page_stays_small_where_all_recordings_tell_much(path, data):
    with StudyFile.open(path, readonly=True) as study:
        packed = page_recordings.encode_important_recordings(study, data, max_characters=1000, sample_characters=6000)
    assert 6000 < sum(map(len, packed.values())) < 6000 + max(map(len, packed.values())) * 2
    assert len(packed) < len(data.rows)


def test_clusters_say_how_long_scenarios_last_and_not_when_they_end(data):
    late = replace(data, time_spans={row.id: (100.0, 102.5) for row in data.rows})
    page = "".join(str(section.html) for section in render_clusterings(late))
    assert ">2.50<" in page
    assert "102.50" not in page


def test_a_course_has_no_value_where_it_is_not_a_number():
    line = np.linspace(1.0, 3.0, COURSE_POINTS)
    line[5:9] = np.nan
    told = encode_courses([line, None, np.full(COURSE_POINTS, np.nan)], [(0.0, 1.0)] * 3)
    codes = np.frombuffer(zlib.decompress(base64.b64decode(told["values"])), "<u2").reshape(3, COURSE_POINTS)
    assert (told["low"], told["high"]) == (1.0, 3.0)
    np.testing.assert_array_equal(codes[0] == 65535, np.isnan(line))
    assert (codes[1:] == 65535).all()
    none = encode_courses([np.full(COURSE_POINTS, np.nan)], [(0.0, 1.0)])
    assert json.loads(json.dumps(none, allow_nan=False)) == none


def test_each_beginning_of_an_even_order_is_spread():
    for count in (1, 2, 7, 100, 1000):
        order = page_recordings._van_der_corput_order(count)
        assert sorted(order) == list(range(count))
        for some in (count // 8, count // 3):
            if some > 4:
                assert np.diff(np.sort(order[:some])).max() <= 2.5 * count / some


HOSTILE = "</script><script>alert(1)</script>\u2028\u202e \" ' & $\\frac{ 歩行者"


def test_no_name_ends_a_script_or_an_attribute(tmp_path):
    plain = SPACE.to_json()
    plain["parameters"][0]["name"] = plain["parameters"][0]["unit"] = HOSTILE
    space = ParameterSpace.from_json(plain)
    meta = about(space, "distance", ego=HOSTILE, other="B", settings={HOSTILE: HOSTILE})
    with StudyFile.create(
        tmp_path / "s.db", replace(meta, scenario="/x/<script><script>alert(1)<script>\u2028 歩行者.xosc")
    ) as study:
        points = np.random.default_rng(1).random((12, 2))
        for row in study.writer.add_pending(1, points, space.values(points)):
            (found,) = Synthetic().run([type("C", (), {"values": {"a": 0.5, "b": row.point[1]}})])
            course = np.full(5, 10 * abs(0.5 - row.point[1]))
            study.writer.record_result(
                row.id, replace(found, names=(HOSTILE, "B")), {"distance": (course, float(course[0]))}
            )
    page = page_of(tmp_path / "s.db", tmp_path, figures=True)
    contents = contents_of(page)
    assert contents["ego"] == contents["parameters"][0]["name"] == HOSTILE
    assert unpacked(page, 1)[0]["names"][0] == HOSTILE
    assert "alert(1)</script>" not in page
    assert page.count("<script") == page.count("</script")
    assert "\u2028" not in page.split('id="contents">')[1]
    # What turns the direction of writing round would turn all after it.
    assert "\u202e" not in page.partition('<script type="application/json"')[0]
    assert "\u202e" not in json.dumps([*contents["answers"], contents["about"]], ensure_ascii=False)
    assert contents["title"] == "<script><script>alert(1)<script>\u2028 歩行者"


KINDS = ["plain", "pareto", "weights", "one", "choices", "fixed", "repeats", "imported"]


@pytest.mark.parametrize("kind", at_night(KINDS, {"plain", "weights", "repeats", "imported", "one", "fixed"}))
def test_every_kind_of_study_has_a_page(tmp_path, kind):
    space, more, scores = SPACE, dict[str, object](), None
    if kind == "pareto":
        more = {"pareto": True}
    elif kind == "weights":
        more = {"weights": {"distance": 1.0, "wttc": 2.0}, "critical": 4.0}
    elif kind == "choices":
        space = ParameterSpace([Parameter("way", 0, 2, choices=("left", "right", "<b>")), SPACE.parameters[1]])
    elif kind == "fixed":
        space = ParameterSpace([Parameter("version", 0, 0, choices=("new",)), *SPACE.parameters])
        more = {"critical": 2.0}
    elif kind == "imported":
        more = {"simulator": "imported", "files": tuple(f"{k}.csv" for k in range(1, 31))}
    elif kind == "repeats":
        more, scores = {"repeats": 3}, {"distance": [1.0, 2.0, 3.0]}
    with StudyFile.create(tmp_path / "s.db", about(space, "distance", "wttc", **more)) as study:
        points = np.random.default_rng(1).random((1 if kind == "one" else 30, space.dimension))
        for row in study.writer.add_pending(1, points, space.values(points)):
            (found,) = Synthetic().run([type("C", (), {"values": {"a": 0.5, "b": row.point[-1]}})])
            course = np.append(np.full(4, 10 * abs(0.5 - row.point[-1])), np.nan)
            study.writer.record_result(
                row.id, found, {name: (course, float(course[0])) for name in ("distance", "wttc")}, scores
            )
    page = page_of(tmp_path / "s.db", tmp_path, figures=True)
    contents = contents_of(page)
    assert len(contents["scenarios"]["id"]) == len(points)
    asked = [one["name"] for one in contents["answers"]]
    assert ("front" in asked) == (kind == "pareto") == (contents["front"] is not None)
    assert ("critical" in asked) == (kind != "pareto")
    assert all(one["text"] for one in contents["answers"])
    if kind == "choices":
        assert contents["parameters"][0]["choices"] == ["left", "right", "<b>"]
        assert set(contents["scenarios"]["values"][0]) <= {0.0, 1.0, 2.0}
    if kind == "imported":
        assert "cornercase import" in page
    if kind == "fixed":
        assert "each parameter weighed by its share" in page
    # Where a course has no value, it is at its cap.
    assert unpacked(page, 1)[1]["course distance"][0][-1] == 100.0


@pytest.mark.parametrize("of", ["one", "several"])
def test_where_all_failed_the_page_says_why_and_what_is_missing(of, tmp_path):
    reasons = ["<b>no road</b>"] if of == "one" else ["too slow", "<b>no road</b>", "<b>no road</b>"]
    with opened(tmp_path / "s.db") as study:
        points = np.array([[0.9 + 0.01 * k, 0.1] for k in range(len(reasons) + 1)])
        explorer(study, metrics=("distance",), optimizer="sobol", budget=len(points))
        rows = study.writer.add_pending(1, points, SPACE.values(points))
        with pytest.raises(InputError, match="no scenario was run yet"):
            write_report(study, tmp_path / "r.html")
        with pytest.raises(InputError, match="nothing to summarize; run some with `explore`"):
            write_one_page_summary(study, tmp_path / "r.html")
        for row, reason in zip(rows, reasons, strict=False):
            study.writer.record_failure(row.id, SimulationError(reason))
    write_report(tmp_path / "s.db", tmp_path / "r.html", figures=True)
    page = (tmp_path / "r.html").read_text()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["r.html", "s.db"]
    assert "<b>no road" not in page
    text = " ".join(re.sub("<[^>]*>", " ", page.partition("<main>")[2]).split())
    if of == "one":
        assert "The one scenario that ended could not be run. 1 not run yet." in page
        assert "1 &lt;b&gt;no road&lt;/b&gt; 1 What is missing" in text
    else:
        assert "All 3 scenarios that ended could not be run. 1 not run yet." in page
        assert "2 &lt;b&gt;no road&lt;/b&gt; 2, 3 1 too slow 1 What is missing" in text
    assert "there are no scores" in text
    assert "--retry-failed and -o s.db runs" in text
    with pytest.raises(InputError, match="'cornercase report' lists what failed"):
        write_one_page_summary(tmp_path / "s.db", tmp_path / "r.html")
    value = format_value(rows[0].values["a"])
    assert f"scenario a b why 1 {value} " in text


def test_answers_say_what_show_says(data):
    words = summary_to_dict(data.summary)
    answers = {one.name: one for one in page_answers(data)}
    share = words["critical"]["share"]
    said = f"About {format_percent(share['value'])} of the space, as far as it can be run, is critical"
    assert said in answers["critical"].text
    assert f"{format_percent(share['low'])} to {format_percent(share['high'])}" in answers["critical"].text
    assert f"{words['critical']['scenarios']} of the {words['run']} scenarios" in answers["critical"].text
    missed = words["critical"]["missed"]
    assert f"About {format_percent(missed['value'])}" in answers["missed"].text
    assert f"could hide {format_percent(words['critical']['hidden'])}" in answers["missed"].text
    sizes = words["clusters"]["distance"]["sizes"]
    assert [int(size) for one in answers["kinds"].points for size in re.findall(r"\((\d+) scenarios\)", one)] == sizes
    first = max(words["sensitivity"]["parameters"].items(), key=lambda item: item[1]["total"])
    assert answers["parameters"].text.startswith(f"{first[0]} matters most")
    assert format_percent(first[1]["total"]) in answers["parameters"].points[0]
    assert f"{words['failed']} of {words['run'] + words['failed']} scenarios" in answers["failed"].text
    reasons = {row.error for row in data.failed}
    assert {one.partition(": ")[2] for one in answers["failed"].points} <= reasons


def test_where_nothing_is_critical_a_bound_is_told_that_holds(tmp_path):
    with StudyFile.create(tmp_path / "s.db", about(SPACE, "distance", "wttc", critical=-1.0, **BY_SOBOL)) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol", budget=60).run()
        data, high = read_report_data(study), known_of(study).critical_fraction.high
    text = next(one.text for one in page_answers(data) if one.name == "critical")
    assert text.startswith(f"None of the {data.summary.n_run} scenarios that were run is critical")
    # The rule of three.
    assert high == pytest.approx(3.0 / data.summary.n_run, rel=0.1)
    assert f"At most {format_percent(high)} of the space, as far as it can be run, is critical" in text


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.0, "0 %"),
        (0.00034, "0.034 %"),
        (3e-7, "below 0.01 %"),
        (0.0995, "10 %"),
        (0.1234, "12 %"),
        (0.999, "over 99 %"),
        (1.0, "100 %"),
    ],
)
def test_a_share_is_told_in_two_digits(share, words):
    assert format_percent(share) == words


def test_the_command_of_a_page_makes_the_study_again(tmp_path):
    x = EXAMPLES / "x_intersection" / "x_intersection"
    made = tmp_path / "s.db"
    options = ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--budget", 6, "--batch", 3, "--seed", 5]
    found = cornercase("explore", f"{x}.xosc", "--space", f"{x}.space.xosc", *options, "--critical", 0.3, "-o", made)
    assert found.returncode == 0, found.stderr
    with StudyFile.open(made, readonly=True) as study:
        name, *words = shlex.split(format_repeat_command(study.meta))
        rows, scores = study.rows(), study.scores("wttc")
    assert (name, words[0], words[-2:]) == ("cornercase", "explore", ["-o", "study.db"])
    again = tmp_path / "again.db"
    found = cornercase(*words[:-1], again, cwd=x.parent)
    assert found.returncode == 0, found.stderr
    with StudyFile.open(again, readonly=True) as study:
        assert [row.values for row in study.rows()] == [row.values for row in rows]
        np.testing.assert_array_equal(study.scores("wttc"), scores)


def test_the_command_of_a_suite_names_its_whole_folder():
    meta = replace(about(SPACE, "distance", suite="0"), scenario="suites/release-1.2", files=("a.xosc",))
    assert shlex.split(format_repeat_command(meta))[:3] == ["cornercase", "test", "release-1.2"]


def test_provenance_says_what_figures_depend_on(path, page):
    made = page.split('id="provenance"')[1]
    for words in (np.__version__, __version__, "scikit-learn", "SciPy", "Python", "seed", "fingerprint", "s.db"):
        assert words in made
    assert str(path.parent) not in page


def test_a_reduced_study_tells_what_is_kept(tmp_path):
    with StudyFile.create(tmp_path / "s.db", about(SPACE, "distance", "wttc", critical=1.0)) as study:
        explorer(study, metrics=("distance", "wttc"), optimizer="sobol").run()
        study.meta = replace(study.meta, simulator="imported", files=tuple(map(str, range(1, 48))))
        analyze(study, "distance", gamma=4.0, eps=0.2, min_samples=3)
        reduced = reduce(study, tmp_path / "reduced", size=6)
        contents = contents_of(page_of(study, tmp_path))
    columns = contents["scenarios"]
    kept = [one for one, chosen in zip(columns["id"], columns["kept"], strict=True) if chosen]
    assert kept == sorted(reduced.ids) == sorted(map(int, contents["kept"]))
    curves = contents["coverage"]["distance"]
    assert curves["kept"] == sorted(curves["kept"])
    assert curves["kept"][-1] == 100.0
    ran = set(columns["id"])
    assert all({*edge} <= ran for edges in contents["hulls"].values() for edge in edges)
    text = next(one["text"] for one in contents["answers"] if one["name"] == "kept")
    assert text.startswith(f"Keep {len(kept)} of the {reduced.n_run} scenarios")
    n_critical, n_collide = (
        sum(columns[key][columns["id"].index(one)] for one in kept) for key in ("critical", "collides")
    )
    who = "All" if n_critical == len(kept) else n_critical
    assert f"{who} of them are critical and in {n_collide or 'none'} Ego collides." in text
    assert contents["kinds"]["distance"]["names"]["0"].startswith("distance 0")


def test_no_folder_of_the_machine_is_told(tmp_path):
    time = np.arange(5.0)
    for k in range(3):
        met((10.0 * time, 0.0 * time, 0.0, 10.0), (5.0 * time, 4.0 + k, 0.0, 5.0)).to_csv(tmp_path / f"{k}.csv")
    (tmp_path / "parameters.csv").write_text("file,gap\n0.csv,0\n1.csv,1\n2.csv,2\n")
    import_recordings(tmp_path, tmp_path / "s.db", ego="Ego", other="Other", metrics=["distance"])
    page = write_report(tmp_path / "s.db", tmp_path / "page.html").read_text()
    assert str(tmp_path) not in page
    assert "parameters.csv" in page


def test_a_report_is_a_page(path, tmp_path):
    with pytest.raises(InputError, match=r"ends with \.html"):
        write_report(path, tmp_path / "report.pdf")


def test_what_does_not_fit_into_the_memory_is_refused(path):
    with StudyFile.open(path, readonly=True) as study:
        run = len(study.finished_rows())
        told = f"^the contents of a report of {run} scenarios need .*, which is more than `memory` .*; give more.$"
        with pytest.raises(InputError, match=told):
            read_report_data(study, memory=MemoryLimit(400_000_001))


def test_a_size_that_is_none_ends_the_command(path, tmp_path):
    ended = cornercase("report", path, "-o", tmp_path / "r.html", "--memory", "4 potatoes")
    assert ended.returncode == 2
    assert ended.stderr == "cornercase: --memory 4 potatoes: give a size such as 4 GB or 500 MB.\n"


def test_whether_it_collides_is_answered_with_the_hardest_first(x_intersection, tmp_path):
    cc.explore(
        x_intersection, tmp_path / "s.db", ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol", budget=60
    )
    with StudyFile.open(tmp_path / "s.db", readonly=True) as study:
        data = read_report_data(study)
        speeds = {
            row.id: hit.speed
            for row in data.rows
            for hit in find_outcome(study.recording(row.id), "Ego", "Pedestrian").impacts[:1]
        }
    answer = next(one for one in page_answers(data) if one.name == "collisions")
    assert 0 < len(speeds) == data.summary.n_collisions
    assert answer.text.startswith(f"Yes: Ego collides with Pedestrian in {len(speeds)} of the 60 scenarios, hardest in")
    # Near misses follow where there are few collisions.
    hits = [point for point in answer.points if point.startswith("Scenario ")]
    assert answer.points[: len(hits)] == tuple(hits)
    order = [int(re.findall(r"Scenario (\d+): ", point)[0]) for point in hits]
    assert f"hardest in scenario {order[0]}, at a relative speed of {speeds[order[0]]:.2g} m/s." in answer.text
    assert order == sorted(speeds, key=lambda scenario: (-speeds[scenario], scenario))[:6]


def test_a_set_is_shown_with_the_coverage_of_the_analyses_that_there_are_now(x_intersection, tmp_path):
    study, charts = tmp_path / "s.db", []
    explore = partial(
        cc.explore, x_intersection, study, ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol"
    )
    explore(budget=20)
    analyze(study, ["wttc"])
    reduce(study, tmp_path / "reduced", size=5)
    explore(budget=30)
    for window in (None, 0.1):
        analyze(study, ["wttc"], window=window)
        with StudyFile.open(study, readonly=True) as opened:
            charts.append(read_report_data(opened).coverage_curves["wttc"])
    write_report(study, tmp_path / "r.html")
    assert len(charts[0].to_selected) == len(charts[1].to_selected) == 30
    assert charts[0].reach[-1] != charts[1].reach[-1]


class Approaching(Synthetic):
    """B comes nearer to the ego for two seconds, and goes away again."""

    def run(self, concretes):
        for recording in super().run(concretes):
            if isinstance(recording, Recording):
                x = recording.x + np.array([[0.0], [1.0]]) * [4.0, 2.0, 0.0, 2.0, 4.0]
                recording = replace(recording, x=x)
            yield recording


def test_near_misses_are_named_where_nothing_collides_and_lead_to_their_replays(tmp_path):
    path = tmp_path / "s.db"
    with StudyFile.create(path, about(SPACE, "distance", "wttc", critical=1.0, **BY_SOBOL)) as study:
        explorer(study, Approaching(), metrics=("distance", "wttc"), optimizer="sobol", budget=20).run()
    with StudyFile.open(path, readonly=True) as study:
        data = read_report_data(study)
    assert not data.hardest_impacts
    assert {approach.time for approach in data.approaches.values()} == {2.0}
    answers = {one.name: one for one in page_answers(data)}
    nearest = min(data.approaches, key=lambda scenario: (data.approaches[scenario].gap, scenario))
    assert answers["collisions"].points[0].startswith(f"Near miss in scenario {nearest}: ")
    gaps = [data.approaches[int(re.findall(r"scenario (\d+)", one)[0])].gap for one in answers["collisions"].points]
    assert gaps == sorted(gaps)
    assert f"in scenario {nearest}: {data.approaches[nearest].gap:.2g} m from B" in answers["fix"].text
    assert f"Near miss in <a href='#id={nearest}'>scenario {nearest}</a>: " in page_of(path, tmp_path)


def test_where_the_dangerous_scenarios_lie_is_said_beside_the_influence(path, data):
    with StudyFile.open(path, readonly=True) as study:
        critical = study.critical_mask()
        values = {name: [float(row.values[name]) for row in study.finished_rows()] for name in study.space.names}
    said = [one for answer in page_answers(data) for one in answer.points if one.startswith("All ")]
    narrow = []
    for parameter in data.parameters:
        inside = [value for value, is_critical in zip(values[parameter.name], critical, strict=True) if is_critical]
        if max(inside) - min(inside) <= 0.6 * (parameter.high - parameter.low):
            narrow.append((parameter.name, f"from {min(inside):.3g} to {max(inside):.3g}", len(inside)))
    assert len(said) == len(narrow)
    for text, (name, place, count) in zip(said, narrow, strict=True):
        assert text.startswith(f"All {count} critical scenarios that were found have {name} {place}")


@pytest.fixture(scope="module")
def joint(tmp_path_factory):
    """A study of values that are set together, and of an option of a driver."""
    folder = tmp_path_factory.mktemp("joint")
    cc.explore(
        joint_values(folder), folder / "s.db", ego="Ego", other="Pedestrian", metrics=["wttc"], optimizer="sobol",
        budget=8, drivers={"Ego": "normal"},
    )  # fmt: skip
    return folder / "s.db"


def test_values_that_are_set_together_do_not_count_as_held_fixed(joint):
    with StudyFile.open(joint, readonly=True) as study:
        assert set(read_report_data(study, charts=False).fixed_parameters) == {
            "ego_speed",
            "pedestrian_speed",
            "truck_speed",
        }


def test_a_page_has_the_file_that_reduce_writes_with_joint_values_and_the_option_of_a_driver(joint, tmp_path):
    with StudyFile.open(joint, readonly=True) as study:
        row, explored = study.finished_rows()[2], find_explored_scenario(study)
        (chosen,) = write_chosen_scenarios(study, tmp_path / "chosen", [row.id])
        assert explored is not None
        given = render_concrete_scenario(study.meta, explored, row, chosen.why)
        rerun = rerun_payload(study)
    written = (tmp_path / "chosen" / chosen.file).read_bytes()
    assert f'value="normal:reaction_time={row.values["Ego.reaction_time"]}"'.encode() in written
    assert given == written
    # What the page inserts: the values of the file, which has them in this order, and of the driver.
    names = ["ego_start", "pedestrian_wait", "p1_speed", "Ego.reaction_time"]
    slots, pieces = rerun["file"]["slots"], rerun["file"]["pieces"]
    texts = [str(row.values[name]) for name in names]
    assert {None, 0, 1, 2, 3} == set(slots)
    described = f"Scenario {row.id} of the logical scenario x_intersection: {chosen.why}"
    filled = [described if slot is None else texts[slot] for slot in slots]
    assert (
        pieces[0] + "".join(text + piece for text, piece in zip(filled, pieces[1:], strict=True))
    ).encode() == written
