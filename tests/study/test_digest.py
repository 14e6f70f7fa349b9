"""Digests: what analysis and report need of recordings, without unpacking them."""

from __future__ import annotations

import io
import sqlite3
import zipfile
from collections import Counter
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

import cornercase as cc
from cornercase.clustering import ASPECTS
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.exploration._repair import repair
from cornercase.metrics import METRICS, compute_features
from cornercase.metrics.ending._ego_features import measure_features
from cornercase.metrics.ending._find_outcome import find_outcome
from cornercase.recordings import Collision, Recording
from cornercase.study import StudyFile, verify
from cornercase.study._checksums import delete_rows, insert_rows
from cornercase.study._codec import pack_arrays, unpack_arrays
from cornercase.study._scenario_digest import (
    decode_digest,
    decode_digest_facts,
    decode_features,
    downsample,
    encode_digest,
    make_digest,
    measure_registered_features,
    registered_features_checksum,
)
from helpers.synthetic_study import SPACE, about, explorer


class CountingStudy(StudyFile):
    """A study that notes which recordings are unpacked."""

    def __init__(self, database):
        super().__init__(database)
        self.unpacked = []

    def recording(self, scenario):
        self.unpacked.append(scenario)
        return super().recording(scenario)


@pytest.fixture(scope="module")
def explored(tmp_path_factory):
    path = tmp_path_factory.mktemp("explored") / "study.db"
    # 81 instants: series of at most 100 are stored whole.
    config = replace(paper_experiment_config("x-intersection", budget=20), duration=4.0)
    explore_config(config, path)
    return path, config.logical.scenario_file


def crossing(n_instants):
    """A car that waits for a pedestrian who crosses and then vanishes, and a car that is hit from behind."""
    time = 0.05 * np.arange(n_instants)
    share = time / time[-1]
    x = np.stack([-30.0 + 60.0 * share**2, np.zeros(n_instants), -60.0 + 95.0 * share])
    y = np.stack([np.zeros(n_instants), -8.0 + 16.0 * share, np.full(n_instants, 3.0)])
    heading = np.repeat([[0.0], [np.pi / 2], [0.0]], n_instants, axis=1)
    speed = np.hypot(np.gradient(x, time, axis=1), np.gradient(y, time, axis=1))
    x[1, -n_instants // 5 :] = np.nan
    return Recording(
        time=time, names=("Ego", "B", "C"), object_types=("car", "pedestrian", "car"), x=x, y=y, heading=heading,
        speed=speed, acceleration=np.gradient(speed, time, axis=1), length=np.array([4.5, 0.6, 4.5]),
        width=np.array([1.8, 0.6, 1.8]), center_x=np.array([1.4, 0.0, 1.4]),
        collisions=(Collision(float(time[-3]), ("Ego", "C")),),
    )  # fmt: skip


@pytest.mark.parametrize(("n_instants", "stride"), [(5, 1), (90, 1), (250, 3), (251, 3)])
def test_a_digest_has_what_the_recording_gives(n_instants, stride):
    recording = crossing(n_instants)
    meta = about(SPACE, "wttc", "distance", other=("B", "C", "Nowhere"))
    courses = {name: METRICS.create(name).course(recording, "Ego", "C") for name in meta.metrics}
    facts, packed = encode_digest(
        make_digest(recording, courses, meta, stride), measure_registered_features(recording, meta)
    )
    digest = decode_digest(decode_digest_facts(facts), packed, meta)

    assert (digest.n_instants, digest.begin, digest.end) == (n_instants, recording.time[0], recording.time[-1])
    assert digest.collisions == recording.collisions
    assert digest.bounds == (
        np.nanmin(recording.x),
        np.nanmin(recording.y),
        np.nanmax(recording.x),
        np.nanmax(recording.y),
    )
    entities = recording.with_absent_entities(meta.others)
    for k, other in enumerate(meta.others):
        outcome = find_outcome(entities, "Ego", other)
        assert repr(digest.outcomes[k]) == repr(outcome)  # NaN is not equal to itself.
        assert repr(digest.features[k]) == repr(measure_features(entities, outcome))
        position, bearing = digest.position_and_bearing(k)
        interaction = np.hstack((digest.ego_position, position))
        for name, stored in (
            ("ego-trajectory", digest.ego_position),
            ("bearing", bearing),
            ("interaction", interaction),
        ):
            whole = ASPECTS.create(name).series(entities, "Ego", other)
            for factor in (1, 2, 5):
                thin = digest.downsample(stored, factor * stride)
                np.testing.assert_array_equal(thin, downsample(whole, factor * stride))
    for k, name in enumerate(meta.metrics):
        np.testing.assert_array_equal(digest.courses[:, k], downsample(courses[name], stride))
        clipped = METRICS.create(name).clip_course(courses[name]).astype(np.float32)
        assert digest.lines[k].min() == clipped.min()


def test_nobody_unpacks_a_recording_that_nobody_looks_at(explored, tmp_path):
    path, scenario = explored
    with CountingStudy.open(path, readonly=False) as study:
        cc.analyze(study)
        cc.reduce(study, tmp_path / "reduced", size=3, scenario=scenario)
        cc.summarize(study)
        assert study.unpacked == []
        # The page has all recordings, as they were stored; each is unpacked once for its events, those of examples again.
        cc.write_report(study, tmp_path / "report.html", scenario=scenario)
        examples = {
            profile.example for analysis in cc.summarize(study).analyses.values() for profile in analysis.profiles
        }
        often = Counter(study.unpacked)
        assert max(often.values()) <= 2
        assert {number for number, count in often.items() if count > 1} <= examples


def test_a_digest_without_rounded_recording_gives_the_same_page(explored, tmp_path):
    path = tmp_path / "study.db"
    path.write_bytes(explored[0].read_bytes())
    cc.write_report(path, tmp_path / "new.html", scenario=explored[1])
    with closing(sqlite3.connect(path)) as connection, connection:
        for number, facts, packed in connection.execute("SELECT scenario, facts, arrays FROM digests").fetchall():
            arrays = {name: array for name, array in unpack_arrays(packed).items() if name != "rounded"}
            insert_rows(connection, "digests", [(number, facts, pack_arrays(arrays, compress=False))])
    assert verify(path).is_sound
    cc.write_report(path, tmp_path / "old.html", scenario=explored[1])
    assert (tmp_path / "old.html").read_bytes() == (tmp_path / "new.html").read_bytes()


def test_the_critical_set_is_predicted_with_stored_features(tmp_path):
    meta = about(SPACE, "distance", critical=1.0, optimizer="level-set", budget=30)
    with CountingStudy(StudyFile.create(tmp_path / "study.db", meta)._database) as study:
        explorer(study, critical=1.0, optimizer="level-set", budget=30).run()
        assert set(study.unpacked) <= {1}  # It is run again to see whether runs repeat.
        study.unpacked.clear()
        critical = cc.summarize(study).estimates.critical
        assert critical is not None
        assert critical.critical_set is not None
        assert critical.critical_set.by_committee
        assert study.unpacked == []
        ids = [row.id for row in study.finished_rows()]
        computed = compute_features(map(study.recording, ids), meta.ego, meta.others)
        np.testing.assert_array_equal(study.features(ids), computed)
        assert np.isnan(study.features([None])).all()
        assert study.features([]).shape == (0, computed.shape[1])
        totals = study.checksum_totals()
    with closing(sqlite3.connect(tmp_path / "study.db")) as connection:
        delete_rows(connection, "digests", "scenario = 7")
        connection.commit()
    repair(tmp_path / "study.db")
    with StudyFile.open(tmp_path / "study.db") as study:
        assert study.checksum_totals() == totals


def test_recordings_are_read_where_the_stored_series_are_too_coarse(tmp_path):
    meta = about(SPACE, "distance", seed=1)
    points = np.random.default_rng(0).random((6, 2))
    with StudyFile.create(tmp_path / "study.db", meta) as study:
        for row in study.writer.add_pending(1, points, SPACE.values(points)):
            recording = crossing(400 + 10 * row.id)
            course = METRICS.create("distance").course(recording, "Ego", "B")
            study.writer.record_result(row.id, recording, {"distance": (course, float(np.nanmin(course)))})
    with CountingStudy.open(tmp_path / "study.db", readonly=False) as study:
        assert {digest.stride for _, digest in study.iter_digests()} == {5}
        analysis = cc.analyze(study, by="interaction")["interaction"]
        assert (analysis.stride, study.unpacked) == (1, [1, 2, 3, 4, 5, 6])


def test_a_digest_with_the_number_of_another_scenario_is_damage_that_verify_lists(explored, tmp_path):
    path = tmp_path / "study.db"
    path.write_bytes(explored[0].read_bytes())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE digests SET scenario = 1000 WHERE scenario = 7")
    words = r"is damaged: its table digests has .*; `verify` lists all damage"
    with StudyFile.open(path) as study, pytest.raises(cc.InputError, match=words):
        list(study.iter_digests())
    assert not verify(path).is_sound


def test_a_lost_digest_is_found_and_made_again(explored, tmp_path):
    path = tmp_path / "study.db"
    path.write_bytes(explored[0].read_bytes())
    with StudyFile.open(path) as study:
        totals = study.checksum_totals()
    with closing(sqlite3.connect(path)) as connection:
        delete_rows(connection, "digests", "scenario IN (1, 7, 20)")
        connection.commit()
    assert not verify(path).is_sound
    repair(path)
    assert verify(path).is_sound
    with StudyFile.open(path) as study:
        assert study.checksum_totals() == totals


def test_a_digest_that_does_not_fit_the_study_is_refused():
    recording, meta = crossing(90), about(SPACE, "distance")
    facts, packed = encode_digest(make_digest(recording, {}, meta, 1), measure_registered_features(recording, meta))
    with pytest.raises(ValueError, match="endings"):
        decode_digest(decode_digest_facts(facts) | {"endings": []}, packed, meta)
    with pytest.raises(ValueError, match="series"):
        decode_digest(decode_digest_facts(facts), packed, replace(meta, other=("B", "C")))


def test_stored_features_are_one_finite_number_each():
    recording, meta = crossing(90), about(SPACE, "distance")
    digest, features = make_digest(recording, {}, meta, 1), measure_registered_features(recording, meta)
    checksum = registered_features_checksum()
    stored = decode_features(encode_digest(digest, features)[1], checksum)
    assert stored is not None
    assert stored.tolist() == features.tolist()
    assert decode_features(encode_digest(digest, features)[1], checksum + 1) is None
    for damaged in (features[:-1], np.full_like(features, np.nan)):
        with pytest.raises(ValueError, match="features"):
            decode_features(encode_digest(digest, damaged)[1], checksum)


@pytest.mark.parametrize("compress", [True, False])
def test_archives_are_those_of_zipfile(compress):
    arrays = {"series": np.arange(300.0).reshape(100, 3), "names": np.array(["Ego", "B"]), "empty": np.zeros((0, 2))}
    buffer = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w", method, compresslevel=1) as archive:
        for name, array in arrays.items():
            content = io.BytesIO()
            np.save(content, array)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy"), content.getvalue(), method, 1)
    assert pack_arrays(arrays, compress) == buffer.getvalue()
    for name, array in unpack_arrays(pack_arrays(arrays, compress)).items():
        np.testing.assert_array_equal(array, arrays[name])
