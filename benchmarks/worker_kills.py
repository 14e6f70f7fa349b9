"""Workers of a Dask cluster that are killed at random while they run an exploration.

Starts a scheduler and three workers on loopback, as one does on machines of one's own (``dask scheduler``, ``dask
worker``), explores the X-intersection on them, and sends SIGKILL to a random worker process at random times until so
many were killed; if the exploration ends before, the exit code is 1. Then the study is compared with that of one
process without a cluster, table by table, byte by byte.

A scenario that costs as many workers as it is tried is given up, whoever ends them. So it is tried ten times here, as
one would on machines that are taken away.

    python benchmarks/worker_kills.py [--quick] [--kills 50] [--seed 0] [--scheduler] [--json FILE]

With ``--scheduler`` the scheduler is killed once in the middle too, a new one is started, and the same command goes on.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sqlite3
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil

X = Path(__file__).parents[1] / "examples" / "x_intersection" / "x_intersection.xosc"
COMMAND = "from cornercase.cli import main; main()"
WORKERS = 3
# Of each kill. Of the scenarios, at most so many end between two kills, and then it is waited for at most so many s: so
# there are as many kills on a fast machine as on a slow one, and they fall anywhere.
SCENARIOS, APART, PAUSE = 12, 8, 1.0
# Not compared: what depends on the clock alone.
CLOCK = {"elapsed"}


def main(arguments: list[str] | None = None) -> int:
    """Kill, compare, and print what was found.

    Parameters
    ----------
    arguments : list of str, optional

    Returns
    -------
    int
        0 if the studies are the same and so many were killed, 1 if not.
    """
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="3 kills")
    parser.add_argument("--kills", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of whom to kill and when")
    parser.add_argument("--scheduler", action="store_true", help="kill the scheduler once, too")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args(arguments)
    kills = 3 if given.quick else given.kills
    with TemporaryDirectory(prefix="cornercase-kills-") as folder:
        found = killed(Path(folder), kills, given.seed, scheduler=given.scheduler)
    for name, value in found.items():
        print(f"{name:32} {value}")
    if given.json is not None:
        given.json.write_text(json.dumps(found, indent=2) + "\n", encoding="utf-8", newline="\n")
    return 0 if found["same"] and found["workers killed"] == kills else 1


def killed(folder: Path, kills: int, seed: int, *, scheduler: bool = False) -> dict[str, Any]:
    """Explore with one process, and on a cluster whose workers are killed.

    Parameters
    ----------
    folder : Path
        For studies and logs.
    kills : int
        How many workers to kill.
    seed : int
        Of whom to kill and when.
    scheduler : bool, default False
        Kill the scheduler once, too, and give the same command again.

    Returns
    -------
    dict of str to object
        ``same``: whether all tables are equal; and counts.
    """
    rng = random.Random(seed)
    # Rounds are short, so that the search, too, goes on between the kills; there are enough for all of them.
    budget = SCENARIOS * max(kills, 3)
    explore(folder, "here.db", budget).wait()
    begun, dead, commands = time.monotonic(), 0, 1
    with Cluster(folder) as cluster:
        running = explore(folder, "there.db", budget, cluster.file)
        wanted = 1
        while running.poll() is None:
            time.sleep(rng.uniform(0.0, PAUSE))
            cluster.revive()
            if dead < kills and (ended := done(folder / "there.db")) >= wanted:
                dead += cluster.kill(rng)
                wanted = ended + rng.randint(0, APART)
            if scheduler and commands == 1 and dead >= kills // 2 and done(folder / "there.db"):
                cluster.restart()
                running.wait()
                commands += 1
                running = explore(folder, "there.db", budget, cluster.file)
    here, there = contents(folder / "here.db"), contents(folder / "there.db")
    said = (folder / "there.db.log").read_text(encoding="utf-8")
    return {
        "same": here == there and running.returncode == 0,
        "differs": ", ".join(name for name in here if here[name] != there.get(name)) or "nothing",
        "workers killed": dead,
        "schedulers killed": commands - 1,
        "commands": commands,
        "scenarios": len(there["scenarios"]),
        "done": sum(row[STATE] == "done" for row in there["scenarios"]),
        "seconds": round(time.monotonic() - begun, 1),
        "last exit code": running.returncode,
        "ended with": said.strip().splitlines()[-1] if said.strip() else "",
    }


STATE = 4


def explore(folder: Path, name: str, budget: int, cluster: Path | None = None) -> subprocess.Popen[bytes]:
    """Start the command.

    Parameters
    ----------
    folder : Path
    name : str
        Of the study.
    budget : int
    cluster : Path, optional
        The file that a scheduler wrote.

    Returns
    -------
    subprocess.Popen
    """
    command = [sys.executable, "-c", COMMAND, "explore", str(X), "--space", str(X.with_suffix(".space.xosc"))]
    command += ["--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--optimizer", "random", "--batch", "6"]
    command += ["--budget", str(budget), "--seed", "1", "--retries", "9", "-o", name]
    if cluster is not None:
        command += ["--cluster", str(cluster)]
    with (folder / f"{name}.log").open("ab") as log:
        return subprocess.Popen(command, cwd=folder, stdout=log, stderr=subprocess.STDOUT)


class Cluster:
    """A scheduler and workers on loopback, each a process of its own.

    Parameters
    ----------
    folder : Path

    Attributes
    ----------
    file : Path
        What the scheduler writes.
    """

    def __init__(self, folder: Path) -> None:
        self.file = folder / "scheduler.json"
        self._folder = folder
        self._scheduler: subprocess.Popen[bytes]
        self._workers: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> Cluster:
        self._start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()

    def kill(self, rng: random.Random) -> int:
        """Kill the process of a random worker; its nanny starts another one.

        Parameters
        ----------
        rng : random.Random

        Returns
        -------
        int
            1, or 0 if it had none just then.
        """
        nanny = rng.choice(self._workers)
        with suppress(psutil.NoSuchProcess):
            # One child is the worker; another one follows multiprocessing's resources.
            for one in psutil.Process(nanny.pid).children():
                if any("spawn_main" in word for word in one.cmdline()):
                    one.kill()
                    return 1
        return 0

    def revive(self) -> None:
        """Start workers anew whose nanny has ended, as it does where its worker is killed before it has begun."""
        for k, one in enumerate(self._workers):
            if one.poll() is not None:
                self._workers[k] = self._worker(k)

    def restart(self) -> None:
        """Kill the scheduler, and start everything anew."""
        self._scheduler.kill()
        self._scheduler.wait()
        self._stop()
        self._start()

    def _start(self) -> None:
        self.file.unlink(missing_ok=True)
        self._scheduler = self._begin("scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard")
        deadline = time.monotonic() + 60.0
        while not self.file.exists() and time.monotonic() < deadline:
            time.sleep(0.1)
        self._workers = [self._worker(k) for k in range(WORKERS)]

    def _worker(self, number: int) -> subprocess.Popen[bytes]:
        return self._begin("worker", "--nthreads", "1", "--no-dashboard", "--name", f"worker-{number}")

    def _begin(self, what: str, *options: str) -> subprocess.Popen[bytes]:
        place = dict(os.environ, DASK_DISTRIBUTED__WORKER__DAEMON="False", DASK_TEMPORARY_DIRECTORY=str(self._folder))
        command = [sys.executable, "-m", "dask", what, "--scheduler-file", str(self.file), *options]
        with (self._folder / f"{what}.log").open("ab") as log:
            return subprocess.Popen(command, cwd=self._folder, stdout=log, stderr=subprocess.STDOUT, env=place)

    def _stop(self) -> None:
        for one in [*self._workers, self._scheduler]:
            one.terminate()
        for one in [*self._workers, self._scheduler]:
            try:
                one.wait(20.0)
            except subprocess.TimeoutExpired:
                one.kill()


def done(study: Path) -> int:
    """Count the scenarios of a study that have ended.

    Parameters
    ----------
    study : Path

    Returns
    -------
    int
    """
    with suppress(sqlite3.Error), reading(study) as opened:
        return int(opened.execute("SELECT count(*) FROM scenarios WHERE state = 'done'").fetchone()[0])
    return 0


def contents(study: Path) -> dict[str, list[tuple[Any, ...]]]:
    """Read all tables of a study but those that depend on the clock alone.

    Parameters
    ----------
    study : Path

    Returns
    -------
    dict of str to list of tuple
        Rows by table.
    """
    with reading(study) as opened:
        names = [name for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {
            name: sorted(opened.execute(f'SELECT * FROM "{name}"'), key=repr) for name in names if name not in CLOCK
        }


@contextmanager
def reading(study: Path) -> Iterator[sqlite3.Connection]:
    """Open a study to read it.

    Parameters
    ----------
    study : Path

    Yields
    ------
    sqlite3.Connection
    """
    with closing(sqlite3.connect(f"file:{study}?mode=ro", uri=True)) as opened:
        yield opened


if __name__ == "__main__":
    sys.exit(main())
