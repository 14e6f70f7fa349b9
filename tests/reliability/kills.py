"""Explorations that are killed at random instants, and given the same command until they have ended.

Each exploration is compared with one that was left alone, table by table but for what depends on the clock; one without
rounds and with several workers, whose result depends on who is first, by its replay. After each kill nothing may be left:
no process and no temporary file after five seconds, and no scenario that was stored before may be missing or changed.

    python tests/reliability/kills.py [--kills 1000] [--seed 0] [--json FILE]

The main process is forked off this one, which has loaded cornercase already: a kill costs tenths of a second, not
seconds. Workers are started as they always are. Linux only.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import re
import secrets
import shutil
import signal
import sqlite3
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import psutil

TESTS = Path(__file__).parents[1]
if str(TESTS) not in sys.path:
    sys.path.insert(0, str(TESTS))

from helpers import stubborn_simulators  # noqa: E402

X = TESTS.parent / "examples" / "x_intersection" / "x_intersection.xosc"
# s in which nothing may be left.
PATIENCE = 5.0
# Not compared: what depends on the clock or the process alone.
OF_THE_CLOCK = ("elapsed", "lease", "sqlite_")
# What may lie beside a study that was killed.
BESIDE = {"study.db", "study.db-wal", "study.db-shm", "study.db.lock"}
# What Python says in a process whose starter was killed before it had told it what it is for.
NEVER_TOLD = re.compile(
    r'Traceback [^\n]*\n  File "<string>", line 1, in <module>\n(?:  File "[^"\n]*multiprocessing/spawn\.py"[^\n]*\n(?:    [^\n]*\n)*)+'
    r"EOFError: Ran out of input\n"
)
SIGNALS = {"asked": signal.SIGTERM, "hung up": signal.SIGHUP, "Ctrl-C": signal.SIGINT}


@dataclass(frozen=True)
class Case:
    """An exploration."""

    search: str
    simulator: str = "builtin"
    more: tuple[str, ...] = ()
    budget: int = 16

    @property
    def name(self) -> str:
        return " ".join([self.search, self.simulator, *self.more])

    @property
    def has_workers(self) -> bool:
        return "--workers" in self.more

    @property
    def depends_on_who_is_first(self) -> bool:
        return self.has_workers and "--asynchronous" in self.more

    def command(self) -> list[str]:
        metrics = ["wttc", "ttc"] if self.simulator == "builtin" else ["distance", "wttc"]
        return [
            "explore", str(X), "--space", str(X.with_suffix(".space.xosc")), "--ego", "Ego", "--other", "Pedestrian",
            *(part for metric in metrics for part in ("--metric", metric)), "--duration", "10", "--seed", "1",
            "--batch", "4", "--budget", str(self.budget), "--retries", "9", "--optimizer", self.search,
            *(() if self.simulator == "builtin" else ("--critical", "0.5")), "--simulator", self.simulator, *self.more,
            "-o", "study.db",
        ]  # fmt: skip


SEARCHES = ("sobol", "random", "grid", "bayes", "level-set", "committee", "auto", "evolutionary:population=8", "optuna")
WORKERS, CLUSTER, WITHOUT_ROUNDS = ("--workers", "2"), ("--cluster", "local", "--workers", "2"), ("--asynchronous",)
HERE_ALONE = (
    *(Case(search, budget=40) for search in SEARCHES),
    *(Case(search, more=WITHOUT_ROUNDS, budget=40) for search in SEARCHES if search != "committee"),
    Case("evolutionary:population=8", more=("--pareto",), budget=40),
    Case("optuna:sampler=nsga2", more=("--pareto",), budget=40),
)
WITH_WORKERS = (
    Case("sobol", "waiting", WORKERS, 60),
    Case("level-set", "waiting", WORKERS, 40),
    Case("bayes", "deaf", WORKERS, 40),
    Case("random", "sumo", WORKERS, 24),
    Case("evolutionary:population=8", "builtin", WORKERS, 40),
    Case("sobol", "waiting", (*WORKERS, *WITHOUT_ROUNDS), 60),
    Case("level-set", "deaf", (*WORKERS, *WITHOUT_ROUNDS), 40),
)
ON_A_CLUSTER = (
    Case("sobol", "waiting", CLUSTER, 40),
    Case("level-set", "builtin", CLUSTER, 40),
    Case("random", "deaf", (*CLUSTER, *WITHOUT_ROUNDS), 40),
)


@dataclass
class Found:
    """What was counted, and each fault in a sentence."""

    kills: Counter[str] = field(default_factory=Counter)
    asked: Counter[str] = field(default_factory=Counter)
    explorations: int = 0
    commands: int = 0
    scenarios: int = 0
    longest: float = 0.0
    faults: list[str] = field(default_factory=list)

    def lines(self) -> dict[str, Any]:
        return {
            "SIGKILLs": self.kills.total(),
            **{f"of {name}": count for name, count in sorted(self.kills.items())},
            **{f"SIGTERM, SIGHUP, SIGINT {name}": count for name, count in sorted(self.asked.items())},
            "explorations": self.explorations,
            "commands": self.commands,
            "scenarios compared": self.scenarios,
            "s until nothing was left, at most": round(self.longest, 2),
            "faults": len(self.faults),
        }


class Run:
    """One command in a process that is forked off this one, and what it leaves."""

    def __init__(self, folder: Path, command: list[str]) -> None:
        self.folder, self.mark = folder, secrets.token_hex(8)
        self.temporary = folder.parent / f"temporary-{folder.name}"
        self.temporary.mkdir(exist_ok=True)
        self.log = folder.parent / f"{folder.name}.log"
        sys.stdout.flush()
        reader, writer = os.pipe()
        self.number = os.fork()
        self.code: int | None = None
        if self.number == 0:
            self._become(command, writer)
        os.close(writer)
        # Only once its group is there can it be killed.
        os.read(reader, 1)
        os.close(reader)

    def _become(self, command: list[str], writer: int) -> None:
        code = 99
        try:
            os.setsid()
            os.close(writer)
            os.nice(0)
            log = os.open(self.log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for number in (1, 2):
                os.dup2(log, number)
            os.chdir(self.folder)
            os.environ |= {"TMPDIR": str(self.temporary), "CORNERCASE_KILLS": self.mark}
            tempfile.tempdir = None
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                signal.signal(number, signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL)
            sys.argv = ["cornercase", *command]
            from cornercase.cli import main

            main()
            code = 0
        except SystemExit as error:
            code = error.code if isinstance(error.code, int) else 1
        except BaseException:
            traceback.print_exc()
        finally:
            with suppress(Exception):
                sys.stdout.flush()
                sys.stderr.flush()
            os._exit(code)

    def wait(self, seconds: float) -> bool:
        """Wait for its end, at most so long; whether it has come."""
        deadline = time.monotonic() + seconds
        while self.code is None:
            number, status = os.waitpid(self.number, os.WNOHANG)
            if number:
                self.code = os.waitstatus_to_exitcode(status)
            elif time.monotonic() > deadline:
                return False
            else:
                time.sleep(0.002)
        return True

    def workers(self) -> list[psutil.Process]:
        return [one for one in self.processes() if "spawn_main" in " ".join(_words(one))]

    def processes(self) -> list[psutil.Process]:
        """All that it has started, by the mark in their environment."""
        mark, found = f"CORNERCASE_KILLS={self.mark}".encode(), []
        for name in os.listdir("/proc"):
            # One that has ended has no environment any more.
            with suppress(OSError, psutil.Error):
                if name.isdigit() and mark in Path("/proc", name, "environ").read_bytes():
                    found.append(psutil.Process(int(name)))
        return found

    def left(self) -> list[str]:
        """Processes and temporary files that are there."""
        found = [" ".join(_words(one))[:120] for one in self.processes()]
        for folder, folders, files in os.walk(self.temporary):
            found += [os.path.relpath(os.path.join(folder, name), self.temporary) for name in (*folders, *files)]
        return found


def _words(process: psutil.Process) -> list[str]:
    with suppress(psutil.Error):
        return process.cmdline()
    return []


class Kills:
    """Kills explorations in a folder, and counts what it finds."""

    def __init__(self, folder: Path, seed: int) -> None:
        self.folder, self.found = folder, Found()
        self._rng = random.Random(seed)
        self._alone: dict[Case, tuple[dict[str, Any], float]] = {}
        stubborn_simulators.install(folder / "packages")
        for path in (TESTS, folder / "packages"):
            sys.path.append(str(path))
        known = [os.environ.get("PYTHONPATH", ""), str(TESTS), str(folder / "packages")]
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, known))

    def explore(self, case: Case, most: int) -> None:
        """Kill an exploration at most so often until it has ended, and compare it."""
        before = len(self.found.faults)
        undisturbed, seconds = self._undisturbed(case)
        folder, stored = self._new_folder(), dict[int, Any]()
        log, kills = "", 0
        for number in range(400):
            run = self._start(folder, case)
            if kills < most:
                kills += self._disturb(run, case, self._rng.uniform(0.0, min(0.4 * seconds, 4.0)))
            elif not run.wait(240.0):
                self._fault(case, "does not end")
                run.wait(0.0)
                os.killpg(run.number, signal.SIGKILL)
                run.wait(10.0)
            self._look_at_what_is_left(case, run)
            stored = self._look_at_what_is_stored(case, folder, stored)
            log = run.log.read_text(encoding="utf-8", errors="replace")
            if "Traceback" in NEVER_TOLD.sub("", log):
                self._fault(case, f"a traceback in command {number}: {log[:3000]}")
            if run.code == 0:
                break
            if run.code is not None and run.code > 0 and run.code not in (129, 130, 143):
                self._fault(case, f"ended with exit code {run.code}: {log[-500:]}")
                break
        else:
            self._fault(case, "never ends")
        # What a killed process was writing beside the study is removed by the next that writes there.
        if beside := {path.name for path in folder.iterdir()} - BESIDE:
            self._fault(case, f"beside the study lies {sorted(beside)}")
        self.found.explorations += 1
        self._compare(case, folder, undisturbed)
        if len(self.found.faults) == before:
            shutil.rmtree(folder)

    def _undisturbed(self, case: Case) -> tuple[dict[str, Any], float]:
        """Tables of an exploration that was left alone, and how long it took."""
        if case not in self._alone:
            folder, begun = self._new_folder(), time.monotonic()
            run = self._start(folder, case)
            if not run.wait(300.0) or run.code != 0:
                raise RuntimeError(f"{case.name}: {run.log.read_text(encoding='utf-8')[-2000:]}")
            self._alone[case] = tables(folder / "study.db"), time.monotonic() - begun
            self._look_at_what_is_left(case, run)
            shutil.rmtree(folder)
        return self._alone[case]

    def _new_folder(self) -> Path:
        folder = self.folder / f"study-{self.found.explorations}-{secrets.token_hex(3)}"
        folder.mkdir()
        return folder

    def _start(self, folder: Path, case: Case) -> Run:
        self.found.commands += 1
        return Run(folder, case.command())

    def _disturb(self, run: Run, case: Case, after: float) -> int:
        """Kill or interrupt what is running, workers several times; how many kills that were."""
        kills = 0
        while not run.wait(after):
            how = self._rng.choice(
                ("group", "main process", "worker", "worker", "worker")
                if case.has_workers
                else ("main process", "group")
            )
            if self._rng.random() < 0.1:
                word = self._rng.choice(list(SIGNALS))
                (os.killpg if self._rng.random() < 0.5 else os.kill)(run.number, SIGNALS[word])
                self.found.asked[word] += 1
                if not run.wait(60.0):
                    self._fault(case, f"{word}, it did not end within 60 s")
                    os.killpg(run.number, signal.SIGKILL)
                    run.wait(10.0)
                elif run.code not in (0, 128 + SIGNALS[word], -SIGNALS[word]):
                    said = run.log.read_text(encoding="utf-8", errors="replace")
                    self._fault(case, f"{word}, it ended with exit code {run.code}: {said[-1000:]}")
                return kills
            if how == "worker":
                workers = run.workers()
                if workers:
                    with suppress(psutil.Error):
                        self._rng.choice(workers).kill()
                        kills += 1
                        self.found.kills["a worker"] += 1
                after = self._rng.uniform(0.0, 1.5)
                if kills > 3:
                    run.wait(240.0)
                    return kills
                continue
            (os.killpg if how == "group" else os.kill)(run.number, signal.SIGKILL)
            run.wait(10.0)
            self.found.kills[f"the {how}"] += 1
            return kills + 1
        return kills

    def _look_at_what_is_left(self, case: Case, run: Run) -> None:
        begun = time.monotonic()
        while left := run.left():
            if time.monotonic() - begun > PATIENCE:
                self._fault(case, f"{PATIENCE:g} s after exit code {run.code} there is still {left[:5]}")
                for one in run.processes():
                    with suppress(psutil.Error):
                        one.kill()
                shutil.rmtree(run.temporary)
                return
            time.sleep(0.02)
        self.found.longest = max(self.found.longest, time.monotonic() - begun)
        run.temporary.rmdir()

    def _look_at_what_is_stored(self, case: Case, folder: Path, before: dict[int, Any]) -> dict[int, Any]:
        """Scenarios that have ended by now, of which none that had ended before may be missing or changed."""
        if not (folder / "study.db").exists():
            if before:
                self._fault(case, "the study is gone")
            return {}
        # Its copy is looked at, as who reads it tidies up.
        with tempfile.TemporaryDirectory(dir=self.folder) as copy:
            for path in folder.glob("study.db*"):
                shutil.copy(path, copy)
            with closing(sqlite3.connect(Path(copy, "study.db"))) as opened:
                try:
                    rows = opened.execute("SELECT * FROM scenarios WHERE state <> 'pending'").fetchall()
                except sqlite3.OperationalError:
                    rows = []
        now = {row[0]: row for row in rows}
        if changed := [number for number, row in before.items() if now.get(number) != row]:
            self._fault(case, f"scenarios {changed[:5]} are lost or changed")
        return now

    def _compare(self, case: Case, folder: Path, undisturbed: dict[str, Any]) -> None:
        found = tables(folder / "study.db") if (folder / "study.db").exists() else {}
        self.found.scenarios += len(found.get("scenarios", ()))
        if not case.depends_on_who_is_first:
            if differ := [name for name in undisturbed if undisturbed[name] != found.get(name)]:
                self._fault(case, f"{differ} differ from those of the undisturbed study")
            return
        states = Counter(row[4] for row in found.get("scenarios", ()))
        if states != {"done": case.budget}:
            self._fault(case, f"its scenarios are {dict(states)}")
        again = Run(folder, [*case.command(), "--check-proposals"])
        if not again.wait(120.0) or again.code != 0:
            self._fault(case, f"replayed, it says {again.log.read_text(encoding='utf-8')[-300:]}")
        self._look_at_what_is_left(case, again)

    def _fault(self, case: Case, words: str) -> None:
        self.found.faults.append(f"{case.name}: {words}")
        print(f"FAULT {self.found.faults[-1]}", flush=True)


def tables(study: Path) -> dict[str, Any]:
    """All tables of a study but those of the clock, sorted."""
    with closing(sqlite3.connect(f"file:{study}?mode=ro", uri=True)) as opened:
        names = [name for (name,) in opened.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {
            name: sorted(opened.execute(f'SELECT * FROM "{name}"'), key=repr)
            for name in names
            if not name.startswith(OF_THE_CLOCK)
        }


def cases(seed: int) -> Iterator[Case]:
    """Cases without end: half the explorations in one process, most others with workers."""
    rng = random.Random(seed)
    kinds: tuple[tuple[Case, ...], ...] = (HERE_ALONE, WITH_WORKERS, ON_A_CLUSTER)
    turns: list[Iterator[Case]] = [iter(()), iter(()), iter(())]
    while True:
        (k,) = rng.choices(range(3), (10, 4, 1))
        case = next(turns[k], None)
        if case is None:
            turns[k] = iter(rng.sample(kinds[k], len(kinds[k])))
            case = next(turns[k])
        yield case


def load(loaded: Sequence[Case]) -> None:
    """Load what the explorations need, and compile it, before anything is forked off."""
    from typer.testing import CliRunner

    from cornercase.cli import app

    with tempfile.TemporaryDirectory() as folder:
        for case in loaded:
            command = case.command()
            command[-1] = str(Path(folder, secrets.token_hex(4)))
            result = CliRunner().invoke(app, command)
            assert result.exit_code == 0, (case.name, result.output, result.exception)


def kill(kills: int, seed: int, folder: Path, seconds: float = float("inf"), chosen: tuple[Case, ...] = ()) -> Found:
    """Kill explorations until there were so many kills, or so many seconds have passed."""
    killing, begun = Kills(folder, seed), time.monotonic()
    load([one for one in chosen if not one.has_workers] or HERE_ALONE)
    for case in chosen or cases(seed):
        if killing.found.kills.total() >= kills or time.monotonic() - begun > seconds:
            break
        each = -(-kills // len(chosen)) if chosen else 12
        killing.explore(case, min(each, kills - killing.found.kills.total()))
        if not chosen:
            print(f"{killing.found.kills.total()} kills, {time.monotonic() - begun:.0f} s: {case.name}", flush=True)
    return killing.found


def main() -> int:
    """Kill, and print what was found."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--kills", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=int(os.environ.get("CORNERCASE_TORTURE_SEED", "0")))
    parser.add_argument("--seconds", type=float, default=float("inf"), help="after which no exploration is begun")
    parser.add_argument("--only", action="append", default=[], metavar="NAME", help="these cases, once each")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    every = (*HERE_ALONE, *WITH_WORKERS, *ON_A_CLUSTER)
    chosen = tuple(one for one in every if one.name in given.only)
    with tempfile.TemporaryDirectory(prefix="kills-") as folder:
        found = kill(given.kills, given.seed, Path(folder), given.seconds, chosen)
    for name, value in found.lines().items():
        print(f"{name:40} {value}")
    for fault in found.faults:
        print(fault)
    if given.json is not None:
        given.json.write_text(json.dumps(found.lines() | {"said": found.faults}, indent=2) + "\n", encoding="utf-8")
    return 1 if found.faults else 0


if __name__ == "__main__":
    sys.exit(main())
