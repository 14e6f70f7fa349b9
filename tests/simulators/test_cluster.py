"""Simulators on a Dask cluster whose workers crash, are killed, or run on other machines."""

from __future__ import annotations

import os
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
import threading
import time
from contextlib import closing, suppress
from dataclasses import replace
from multiprocessing import current_process
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cornercase as cc
from conftest import EXAMPLES, same_recording
from cornercase._common.errors import InputError, NoticeWarning, SimulationError
from cornercase._common.process import dask
from cornercase._common.version import __version__
from cornercase.drivers import Driver
from cornercase.exploration._explore import explore_config
from cornercase.exploration._paper_examples import paper_experiment_config
from cornercase.scenario import ConcreteScenario, LogicalScenario
from cornercase.scenario._bundle import ScenarioBundle
from cornercase.scenario._file import ScenarioFile
from cornercase.simulators import SIMULATORS, Builtin
from cornercase.simulators._create import create_simulator
from cornercase.simulators.dask._simulator import ClusterSimulator
from cornercase.simulators.dask._worker import SimulatorSetup, TaskId, run_scenarios_of_job
from cornercase.study import StudyFile
from cornercase.suite import analyze_mutants
from helpers.fake_simulators import Plan

distributed = pytest.importorskip("distributed")

X = EXAMPLES / "x_intersection" / "x_intersection.xosc"


@pytest.fixture(scope="module")
def client():
    """Clusters are slow to start, so these tests share one."""
    with dask.open_connection("local", 2) as made:
        yield made


@pytest.fixture
def on_cluster(client):
    return lambda name, options, **given: ClusterSimulator(name, options, client, **given)


def fakes(count):
    source = ScenarioFile.read(X)
    return [ConcreteScenario(X, {"k": float(k)}, source) for k in range(count)]


def places(results):
    return [str(one) if isinstance(one, SimulationError) else int(one.x[0, 0]) for one in results]


def varied(count):
    logical = LogicalScenario.read(X, X.with_suffix(".space.xosc"))
    points = np.random.default_rng(0).random((count, logical.space.dimension))
    return [logical.concrete_scenario(values) for values in logical.space.values(logical.space.snap(points))]


def test_recordings_are_those_of_one_process(on_cluster):
    concretes = varied(5)
    with SIMULATORS.create("builtin", duration=10.0) as here, on_cluster("builtin", {"duration": 10.0}) as there:
        for one, other in zip(here.run(concretes), there.run(concretes), strict=True):
            assert same_recording(one, other)


def test_random_sensors_have_the_numbers_of_one_process(on_cluster):
    options: dict[str, Any] = {"duration": 8.0, "drivers": {"Ego": "normal + lidar:noise=2,miss=0.3"}}
    concretes = [ConcreteScenario(X, seed=seed) for seed in (0, 1, 1)]
    with on_cluster("builtin", options) as simulator:
        results = list(simulator.run(concretes))
    for one, other in zip(results, Builtin(**options).run(concretes), strict=True):
        assert same_recording(one, other)
    assert same_recording(results[1], results[2])
    assert not same_recording(results[0], results[1])


def test_who_crashes_costs_itself_alone(on_cluster, tmp_path):
    plan = Plan(tmp_path, {1: ["crash", "well"], 3: ["crash"], 4: ["fail"]})
    with on_cluster("failing", {"plan": plan}) as simulator:
        found = places(simulator.run(fakes(6)))
    gone = "the simulator's process ended with exit code 3, tried 2 times"
    assert found == [0, 1, 2, gone, "it cannot be", 5]
    assert len((tmp_path / "starts").read_text()) <= 2 + 3


class Hard(Driver):
    """Brakes harder than its car can, and ends Python if it starts far along its path."""

    def acceleration(self, situation):
        if (situation.active & (situation.distance > 60.0)).any():
            sys.exit(0)
        return np.full(len(situation.speed), -30.0)


# Sent with its code, like a class defined in a notebook.
Hard.__module__ = "__main__"


def test_42_s5_a_driver_fails_and_is_noticed_on_a_cluster_as_here(on_cluster):
    concretes = [ConcreteScenario(X, {"ego_start": start}, ScenarioFile.read(X)) for start in (30.0, 70.0, 40.0)]
    options: dict[str, Any] = {"duration": 1.0, "drivers": {"Ego": Hard()}}
    with SIMULATORS.create("builtin", **options) as here, on_cluster("builtin", options) as there:
        with pytest.warns(NoticeWarning) as noticed:
            alone, lost, other = here.run(concretes)
        assert len(noticed) == 1
        said = noticed[0].message
        assert "exceeds the deceleration of 9 m/s² in <Performance>" in str(said)
        with pytest.warns(NoticeWarning) as noticed:
            found = list(there.run(concretes))
        assert [str(one.message) for one in noticed] == [str(said)]
    assert same_recording(found[0], alone)
    assert same_recording(found[2], other)
    assert str(found[1]) == str(lost)
    assert "failed at t = 0 s: SystemExit: 0 (test_cluster.py line " in str(lost)


def test_each_worker_starts_the_simulator_once_and_closes_it(on_cluster, tmp_path):
    with on_cluster("failing", {"plan": Plan(tmp_path)}) as simulator:
        for _ in range(2):
            assert places(simulator.run(fakes(6))) == list(range(6))
    starts = len((tmp_path / "starts").read_text())
    assert 1 <= starts <= 2
    assert len((tmp_path / "ends").read_text()) == starts


def test_a_worker_that_is_killed_costs_nothing(on_cluster, client):
    concretes = varied(6)
    with SIMULATORS.create("builtin", duration=10.0) as here, on_cluster("builtin", {"duration": 10.0}) as there:
        first = list(there.run(concretes[:2]))
        # The scenario's files were on that worker too.
        os.kill(next(iter(client.run(os.getpid).values())), signal.SIGKILL)
        found = [*first, *there.run(concretes[2:])]
        for one, other in zip(here.run(concretes), found, strict=True):
            assert same_recording(one, other)


def about_its_process():
    return os.getpid(), current_process().daemon, "CORNERCASE_GUARDIAN" in os.environ


@pytest.mark.slow
def test_a_worker_that_is_started_again_may_start_processes_and_is_guarded(client):
    before = set(client.run(os.getpid).values())
    os.kill(min(before), signal.SIGKILL)
    found: list[tuple[int, bool, bool]] = []
    deadline = time.monotonic() + 60.0
    while len(found) < 2 or {number for number, *_ in found} == before:
        assert time.monotonic() < deadline
        time.sleep(0.1)
        with suppress(OSError):
            found = list(client.run(about_its_process).values())
    assert all(not daemon and guarded for _, daemon, guarded in found)


@pytest.mark.slow
def test_a_scenario_that_kills_two_workers_is_failed_and_costs_no_third(on_cluster, tmp_path):
    plan = Plan(tmp_path, {1: ["kill"], 3: ["kill", "well"]})
    with on_cluster("inside", {"plan": plan}) as simulator:
        # One at a time, and in one batch for each of two workers.
        one_by_one = [places(simulator.run([one]))[0] for one in fakes(4)]
    assert one_by_one == [0, "2 workers were lost while running the scenario", 2, 3]
    assert [(tmp_path / f"tries-{k}").stat().st_size for k in range(4)] == [1, 2, 1, 2]


@pytest.mark.slow
def test_a_batch_that_costs_its_worker_is_run_one_by_one(on_cluster, tmp_path):
    with on_cluster("inside", {"plan": Plan(tmp_path, {1: ["kill"]})}) as simulator:
        found = places(simulator.run(fakes(4)))
    assert found == [0, "2 workers were lost while running the scenario", 2, 3]
    assert (tmp_path / "tries-1").stat().st_size == 2


@pytest.mark.slow
def test_a_simulator_goes_to_no_others_after_the_workers_that_offer_it_were_lost(client, tmp_path):
    security = client.security
    for name, content in (
        ("ca", security.tls_ca_file),
        ("cert", security.tls_worker_cert),
        ("key", security.tls_worker_key),
    ):
        (tmp_path / f"{name}.pem").write_text(content)
    command = [sys.executable, "-m", "dask", "worker", client.scheduler.address, "--resources", "inside=1"]
    for option, name in (("--tls-ca-file", "ca"), ("--tls-cert", "cert"), ("--tls-key", "key")):
        command += [option, str(tmp_path / f"{name}.pem")]
    place = dict(os.environ, DASK_DISTRIBUTED__WORKER__DAEMON="False", DASK_TEMPORARY_DIRECTORY=str(tmp_path))
    place["PYTHONPATH"] = os.pathsep.join(sys.path)
    with subprocess.Popen([*command, "--nthreads", "1", "--no-nanny", "--no-dashboard"], env=place) as special:
        client.wait_for_workers(3, timeout=60)
        plan = Plan(tmp_path, {1: ["hang"]})
        with ClusterSimulator("inside", {"plan": plan}, client, worker_timeout=1.0) as simulator:
            assert places(simulator.run(fakes(1))) == [0]
            # The worker is lost while it runs the next scenario.
            threading.Timer(2.0, special.kill).start()
            for scenarios in (fakes(2)[1:], fakes(1)):
                with pytest.raises(InputError, match="has no workers that offer inside; start some"):
                    list(simulator.run(scenarios))


@pytest.mark.slow
def test_more_retries_are_more_workers(on_cluster, tmp_path):
    with on_cluster("inside", {"plan": Plan(tmp_path, {0: ["kill", "kill", "well"]})}, retries=2) as simulator:
        assert places(simulator.run(fakes(1))) == [0]


def test_what_the_simulator_refuses_names_the_files_of_the_user(on_cluster, tmp_path):
    (tmp_path / "roadless.xosc").write_text(X.read_text().replace("x_intersection.xodr", "gone.xodr"))
    scenario = ScenarioFile.read(tmp_path / "roadless.xosc")
    with on_cluster("builtin", {}) as simulator, pytest.raises(InputError) as caught:
        list(simulator.run([ConcreteScenario(scenario.path, {}, scenario)]))
    assert str(tmp_path / "gone.xodr") in str(caught.value)


def test_a_study_and_a_suite_are_those_of_one_process(client, tmp_path):
    configuration = replace(paper_experiment_config("x-intersection", budget=12), duration=10.0, batch=4)
    explore_config(configuration, tmp_path / "here.db")
    explore_config(replace(configuration, cluster=client), tmp_path / "there.db")
    assert stored(tmp_path / "here.db") == stored(tmp_path / "there.db")
    for place, cluster in (("here", None), ("there", client)):
        cc.analyze(tmp_path / f"{place}.db", ["wttc"], cluster=cluster)
        cc.reduce(tmp_path / f"{place}.db", tmp_path / place, size=3, scenario=X)
    assert analysed(tmp_path / "here.db") == analysed(tmp_path / "there.db")
    result = cc.run_suite(tmp_path / "there", tmp_path / "run.db", cluster=client)
    assert all(one.difference is not None and one.difference.same for one in result.scenarios)


@pytest.mark.slow
def test_an_analysis_and_a_reduced_set_are_those_of_one_process(client, tmp_path):
    """Compare the bytes of the study and of all output files, including mutants."""
    configuration = replace(paper_experiment_config("x-intersection", budget=16), duration=10.0, batch=16)
    for place, cluster in (("here", None), ("there", client)):
        study = tmp_path / place / "study.db"
        study.parent.mkdir()
        explore_config(configuration, study)
        cc.analyze(study, ["wttc", "ego-trajectory"], cluster=cluster)
        exposure = analyze_mutants(study, 3, scenario=X, cluster=cluster)
        cc.reduce(study, tmp_path / place / "kept", size=4, scenario=X, kill_matrix=exposure)
    found = [analysed(tmp_path / place / "study.db") for place in ("here", "there")]
    assert found[0] == found[1]
    assert sum(name == "distances" for _, name, _ in found[0]) == 2
    kept = [
        {one.name: one.read_bytes() for one in (tmp_path / place / "kept").iterdir()} for place in ("here", "there")
    ]
    assert kept[0] == kept[1]


def analysed(path):
    with closing(sqlite3.connect(path)) as study:
        return study.execute("SELECT analysis, name, data FROM arrays ORDER BY analysis, name, part").fetchall()


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="nothing can be kept there")
def test_an_interrupt_waits_until_a_local_cluster_has_ended():
    class Local:
        ended = False

        def close(self):
            signal.raise_signal(signal.SIGINT)
            self.ended = True

    class Connection:
        cluster = Local()

        def close(self, timeout):
            pass

    connection: Any = Connection()
    with pytest.raises(KeyboardInterrupt):
        dask.disconnect(connection)
    assert connection.cluster.ended


def test_a_scheduler_that_is_lost_between_two_rounds_is_told():
    class Lost:
        cluster = scheduler = None

        def wait_for_workers(self, *_, **__):
            raise OSError("Timed out trying to connect to tcp://127.0.0.1:9 after 20 s")

    lost: Any = Lost()
    with pytest.raises(InputError, match="the connection to its scheduler is lost"):
        dask.wait_for_workers(lost)


def test_processes_of_no_cluster_are_refused(tmp_path):
    configuration = replace(paper_experiment_config("x-intersection", budget=2), duration=2.0)
    explore_config(configuration, tmp_path / "study.db")
    with pytest.raises(InputError, match="`workers`: needs a local cluster"):
        cc.analyze(tmp_path / "study.db", workers=2)


def stored(path):
    with StudyFile.open(path, readonly=True) as study:
        rows = study.finished_rows()
        motion = [[getattr(study.recording(row.id), name).tobytes() for name in ("x", "y", "speed")] for row in rows]
        values = [(row.id, row.state, dict(row.values)) for row in rows]
        return values, motion, [study.scenario_scores(row.id) for row in rows], study.meta


@pytest.mark.slow
def test_a_driver_of_ones_own_is_found_in_the_current_folder(tmp_path, reduced_by_hand):
    (tmp_path / "mine.py").write_text(
        "import numpy as np\nfrom cornercase.drivers import Driver\n\n\nclass Calm(Driver):\n"
        "    def acceleration(self, situation):\n        return np.full(len(situation.x), -1.0)\n"
    )
    given = ["--driver", "Ego=mine:Calm", "--ego", "Ego", "--other", "Pedestrian", "--duration", "5"]
    for more in ([], ["--cluster", "local"]):
        # Like the console script, without the current folder on Python's path.
        script = "import sys; sys.path.remove(''); from cornercase.cli import main; main()"
        command = [sys.executable, "-c", script, "test", "suite", *given, *more, "-o", f"{len(more)}.db"]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=200, check=False)
        assert done.returncode == 0, done.stderr
    with (
        StudyFile.open(tmp_path / "0.db", readonly=True) as one,
        StudyFile.open(tmp_path / "2.db", readonly=True) as other,
    ):
        assert same_recording(one.recording(1), other.recording(1))


def test_a_driver_that_a_worker_lacks_is_told():
    gone = b"cgone_module\nDriver\n."
    with pytest.raises(InputError, match=r"a worker cannot load a driver of your own .*gone_module"):
        run_scenarios_of_job(
            SimulatorSetup("another key", __version__, "builtin", gone, None, 1), TaskId("one", 2), {}, []
        )


@pytest.fixture
def reduced_by_hand(tmp_path):
    (tmp_path / "suite").mkdir()
    for one in (X, X.with_suffix(".xodr")):
        shutil.copy(one, tmp_path / "suite")


def test_no_scheduler_is_told(tmp_path):
    for given in ("tcp://127.0.0.1:9", "nowhere", str(tmp_path / "none.json")):
        with pytest.raises(InputError, match="no scheduler answers"):
            dask.connect(given, answer_timeout=0.5)
    (tmp_path / "scheduler.json").write_text("{}")
    with pytest.raises(InputError, match="no scheduler answers"):
        dask.connect(str(tmp_path / "scheduler.json"), answer_timeout=0.5)
    with pytest.raises(InputError, match="`workers`: the cluster itself says how many"):
        create_simulator("builtin", {}, cluster="tcp://127.0.0.1:9", workers=2)


def test_another_program_that_listens_is_no_scheduler():
    """Dask interprets the first bytes as lengths, and would allocate exabytes of memory."""
    with socket.create_server(("127.0.0.1", 0)) as other:

        def answer():
            line, _ = other.accept()
            with line:
                line.sendall(b"HTTP/1.1 400 Bad Request\r\n" * 9)
                line.recv(1)

        threading.Thread(target=answer, daemon=True).start()
        with pytest.raises(InputError, match="no scheduler answers"):
            create_simulator("builtin", {}, cluster=f"tcp://127.0.0.1:{other.getsockname()[1]}")


def test_another_program_that_listens_and_is_silent_is_no_scheduler():
    with (
        socket.create_server(("127.0.0.1", 0)) as other,
        pytest.raises(InputError, match="no scheduler answers"),
    ):
        dask.connect(f"tcp://127.0.0.1:{other.getsockname()[1]}", answer_timeout=0.5)


def test_a_worker_of_another_version_is_told():
    with pytest.raises(InputError, match=r"a worker has cornercase .*, this machine has 0\.0\.0"):
        run_scenarios_of_job(SimulatorSetup("key", "0.0.0", "builtin", b"", None, 1), TaskId("one", 2), {}, [])


def test_a_parcel_has_all_files_wherever_they_lie(tmp_path):
    (tmp_path / "a" / "scenarios").mkdir(parents=True)
    (tmp_path / "a" / "roads").mkdir()
    (tmp_path / "a" / "catalogs").mkdir()
    text = X.read_text().replace("x_intersection.xodr", "../roads/x.xodr")
    text = text.replace(
        "<CatalogLocations/>",
        '<CatalogLocations><VehicleCatalog><Directory path="../catalogs"/></VehicleCatalog></CatalogLocations>',
    )
    (tmp_path / "a" / "scenarios" / "x.xosc").write_text(text)
    (tmp_path / "a" / "roads" / "x.xodr").write_bytes(X.with_suffix(".xodr").read_bytes())
    (tmp_path / "a" / "catalogs" / "c.xosc").write_text('<OpenSCENARIO><Catalog name="c"/></OpenSCENARIO>')
    scenario = ScenarioFile.read(tmp_path / "a" / "scenarios" / "x.xosc")
    parcel = ScenarioBundle.from_file(scenario)
    assert "catalogs" in text
    assert set(parcel.files) == {"scenarios/x.xosc", "roads/x.xodr", "catalogs/c.xosc"}
    # Later files in that folder are ignored.
    (tmp_path / "a" / "roads" / "x.xodr").write_text("changed")
    unpacked = parcel.unpack(tmp_path / "b")
    assert unpacked.root is not None
    assert unpacked.fingerprint() == scenario.fingerprint()
    road = unpacked.road_path_for()
    assert road is not None
    assert road.read_bytes() == X.with_suffix(".xodr").read_bytes()


@pytest.mark.parametrize("folder", ["elsewhere", "scenarios/roads"])
def test_a_file_that_other_machines_do_not_have_is_refused(tmp_path, folder):
    road = tmp_path / folder / "x.xodr"
    road.parent.mkdir(parents=True)
    road.write_bytes(X.with_suffix(".xodr").read_bytes())
    (tmp_path / "scenarios").mkdir(exist_ok=True)
    file = tmp_path / "scenarios" / "x.xosc"
    file.write_text(X.read_text().replace("x_intersection.xodr", road.as_posix()))
    with pytest.raises(InputError, match=r"names .*x\.xodr by an absolute path"):
        ScenarioBundle.from_file(ScenarioFile.read(file))


def test_the_folder_of_a_parcel_is_that_of_all_files():
    parcel = ScenarioBundle.from_file(ScenarioFile.read(X))
    assert Path(parcel.common_folder) == X.parent.resolve()
    assert parcel.scenario_path == X.name


@pytest.mark.slow
def test_without_rounds_the_scenarios_are_those_of_one_process(client, tmp_path):
    one = replace(paper_experiment_config("x-intersection", budget=9, seed=1), optimizer="sobol", duration=10.0)
    explore_config(one, tmp_path / "here.db")
    explore_config(replace(one, cluster=client, asynchronous=True), tmp_path / "there.db")
    with (
        StudyFile.open(tmp_path / "here.db", readonly=True) as here,
        StudyFile.open(tmp_path / "there.db", readonly=True) as there,
    ):
        assert len(there.result_order()) == len(there.finished_rows()) == 9
        for row, other in zip(here.rows(), there.rows(), strict=True):
            assert row.point.tobytes() == other.point.tobytes()
            assert same_recording(here.recording(row.id), there.recording(row.id))
