"""Studies that are damaged at random, and what each command makes of them.

Whether a damage says anything is told apart by reading the damaged file and the whole one with SQLite alone: where both hold the
same rows, and SQLite's own check finds nothing, the damage is to bytes that mean nothing, as those of free pages.
"""

from __future__ import annotations

import json
import shutil
import sqlite3
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import cornercase as cc
from cornercase.study import verify
from cornercase.study._schema import CREATE_STATEMENTS, TABLES
from helpers.command_line import cornercase

EXAMPLE = Path(cc.__file__).parents[2] / "examples" / "x_intersection"
BUDGET = 12
# The clock is in the one, who writes in the other.
_APART = ("elapsed", "lease")
# What is said where what the study is about is gone, or a number in its head is that of something else.
_REFUSED = ("cannot be restored", "nothing is left of one", "has schema version", "not a cornercase study")
_ANALYSED = ("analyses", "arrays", "outcomes", "tallies")


# Kinds of studies that are damaged: how each is explored.
KINDS: dict[str, tuple[str, ...]] = {
    "sobol": ("--optimizer", "sobol"),
    # With all tables that only some studies have and that can be brought back.
    "level-set": ("--optimizer", "level-set", "--critical", "1", "--other", "C", "--repeats", "2", "--audit", "0.25"),
}


def exploring(folder: Path, kind: str) -> tuple[Any, ...]:
    """The command that explores a study of a kind; its scenario file lies beside it."""
    return (
        "explore", folder / "x_intersection.xosc", "--space", folder / "x_intersection.space.xosc",
        "--ego", "Ego", "--other", "Pedestrian", "--metric", "wttc", "--metric", "distance", *KINDS[kind],
        "--budget", str(BUDGET), "--batch", "4", "--duration", "8", "--time-step", "0.2", "-o", folder / "s.db",
    )  # fmt: skip


def whole_study(folder: Path, kind: str) -> Path:
    """A study that was explored and analysed; its scenario file lies beside it."""
    for name in EXAMPLE.iterdir():
        shutil.copy(name, folder / name.name)
    for words in (exploring(folder, kind), ("analyze", folder / "s.db", "--by", "wttc")):
        done = cornercase(*words)
        assert done.returncode == 0, done.stderr
    return folder / "s.db"


def held(path: Path, *but: str, check: bool = True) -> dict[str, Any] | None:
    """What a file holds; None where SQLite cannot tell, or finds it damaged where that is looked at."""
    try:
        with closing(sqlite3.connect(path)) as connection:
            # What it names may be no text any more.
            connection.text_factory = lambda raw: raw.decode(errors="replace")
            if check and connection.execute("PRAGMA integrity_check").fetchall() != [("ok",)]:
                return None
            connection.text_factory = str
            found: dict[str, Any] = {
                name: connection.execute(f"SELECT * FROM {name}").fetchall()
                for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")
                if name in CREATE_STATEMENTS and name not in but
            }
            found["schema"] = connection.execute("SELECT type, name, sql FROM sqlite_master ORDER BY name").fetchall()
            found["version"] = connection.execute("PRAGMA user_version").fetchone()
            found["application"] = connection.execute("PRAGMA application_id").fetchone()
            return found
    except (sqlite3.Error, UnicodeDecodeError):
        return None


def damage(path: Path, rng: np.random.Generator) -> str:
    """Damage a study in one of several ways; say how."""
    kind = str(rng.choice(["flip", "zero", "cut", "blob", "value", "row", "noise"]))
    if kind in ("blob", "value", "row"):
        return _by_sql(path, rng, kind)
    data = bytearray(path.read_bytes())
    at = int(rng.integers(len(data)))
    if kind == "flip":
        for k in rng.integers(len(data), size=int(rng.integers(1, 20))):
            data[k] ^= 1 << int(rng.integers(8))
    elif kind == "zero":
        count = int(rng.integers(1, 5000))
        data[at : at + count] = bytes(len(data[at : at + count]))
    elif kind == "noise":
        count = int(rng.integers(1, 5000))
        data[at : at + count] = rng.bytes(len(data[at : at + count]))
    else:
        del data[at:]
    path.write_bytes(bytes(data))
    return f"{kind} at {at}"


def _by_sql(path: Path, rng: np.random.Generator, kind: str) -> str:
    with closing(sqlite3.connect(path)) as connection, connection:
        there = {name for (name,) in connection.execute("SELECT name FROM sqlite_master")}
        filled = [
            name
            for name in TABLES
            if name in there and connection.execute(f"SELECT 1 FROM {name}").fetchone() is not None
        ]
        table = str(rng.choice([name for name in filled if TABLES[name].has_blob or kind != "blob"]))
        about = TABLES[table]
        keys = connection.execute(f"SELECT {', '.join(about.columns[: about.n_key_columns])} FROM {table}").fetchall()
        key = keys[int(rng.integers(len(keys)))]
        where = " AND ".join(f"{name} = ?" for name in about.columns[: about.n_key_columns])
        if kind == "row" and table != "elapsed":
            connection.execute(f"DELETE FROM {table} WHERE {where}", key)
            return f"{kind} of {table} {key}"
        column = about.columns[-1] if kind == "blob" else str(rng.choice(about.columns[about.n_key_columns :]))
        (value,) = connection.execute(f"SELECT {column} FROM {table} WHERE {where}", key).fetchone()
        other = _other(value, rng)
        try:
            connection.execute(f"UPDATE {table} SET {column} = ? WHERE {where}", (other, *key))
        except sqlite3.IntegrityError:
            connection.execute(f"DELETE FROM {table} WHERE {where}", key)
        return f"{kind} of {table} {key} {column}"


def _other(value: Any, rng: np.random.Generator) -> Any:
    if isinstance(value, bytes) and value:
        changed = bytearray(value)
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
        return bytes(changed)
    if isinstance(value, str) and value:
        at = int(rng.integers(len(value)))
        return value[:at] + "x" + value[at + 1 :]
    if isinstance(value, int | float):
        return value + 1
    return "x"


@dataclass
class Tried:
    """What was counted of damaged studies."""

    studies: int = 0
    meaningless: int = 0
    repaired: int = 0
    refused: int = 0
    faults: list[str] = field(default_factory=list)


class Harness:
    """Damages copies of a study of a kind, and tries all commands on them."""

    def __init__(self, folder: Path, kind: str = "sobol") -> None:
        self.folder, self.kind = folder, kind
        (folder / "whole").mkdir()
        self.whole = whole_study(folder / "whole", kind)
        cornercase(*self._reading(self.whole, folder / "out")["reduce"])
        self.said = {
            name: cornercase(*words).stdout for name, words in self._reading(self.whole, folder / "out").items()
        }
        self.undisturbed, self.explored = held(self.whole, *_APART), held(self.whole, *_APART, *_ANALYSED)
        self.tried = Tried()

    def _reading(self, study: Path, out: Path) -> dict[str, tuple[Any, ...]]:
        return {
            "show": ("show", study, "--json"),
            "export": ("export", study, "-o", out / "tables"),
            "report": ("report", study, "-o", out / "r.html"),
            "reduce": ("reduce", study, "-o", out / "reduced"),
        }

    def _writing(self, study: Path) -> dict[str, tuple[Any, ...]]:
        return {"explore": exploring(study.parent, self.kind), "analyze": ("analyze", study, "--by", "wttc")}

    def one(self, seed: int, commands: tuple[str, ...]) -> None:
        """Damage a copy by a seed, and try commands on copies of that."""
        rng = np.random.default_rng(seed)
        place = self.folder / f"study {seed}"
        shutil.copytree(self.whole.parent, place)
        study = place / "s.db"
        how = damage(study, rng)
        self.tried.studies += 1
        now = held(study, *_APART)
        # What is said of the time that was spent is told too.
        meaningless = now is not None and now == self.undisturbed and held(study, "lease") == held(self.whole, "lease")
        self.tried.meaningless += meaningless
        problems = _told(study)
        if not problems and not meaningless:
            self._fault(seed, how, "verify finds nothing")
        for name in commands:
            self._try(seed, how, place, name, meaningless)
        self._repair(seed, how, study, bool(problems))
        shutil.rmtree(place)

    def _try(self, seed: int, how: str, place: Path, name: str, meaningless: bool) -> None:
        copy = self.folder / "copy"
        shutil.copytree(place, copy)
        study = copy / "s.db"
        result = cornercase(*(self._reading(study, copy / "out") | self._writing(study))[name])
        lines = result.stderr.strip().splitlines()
        if result.returncode not in (0, 1, 2) or "Traceback" in result.stderr or "please report" in result.stderr:
            self._fault(seed, how, f"{name}: {result.returncode} {lines[-1:]}")
        elif result.returncode == 0 and name == "show" and not meaningless:
            if _timeless(result.stdout) != _timeless(self.said["show"]):
                self._fault(seed, how, "show tells something else")
        elif result.returncode == 0 and name == "explore" and not meaningless:
            # What it neither reads nor writes may stay damaged.
            if held(study, *_APART, *_ANALYSED, check=False) != self.explored:
                self._fault(seed, how, "explore went on over it")
        elif result.returncode == 0 and name == "export" and not meaningless:
            whole, other = (_files(one) for one in (self.folder / "out" / "tables", copy / "out" / "tables"))
            if whole != other:
                self._fault(seed, how, "export writes something else")
        shutil.rmtree(copy)

    def _repair(self, seed: int, how: str, study: Path, damaged: bool) -> None:
        result = cornercase("verify", study, "--repair")
        if "Traceback" in result.stderr or "please report" in result.stderr or result.returncode not in (0, 1, 2):
            self._fault(seed, how, f"repair: {result.stderr[-300:]}")
            return
        if result.returncode == 2:
            self.tried.refused += 1
            if not any(one in result.stderr for one in _REFUSED):
                self._fault(seed, how, f"repair: {result.stderr[-300:]}")
            elif _REFUSED[0] in result.stderr and _about(study) == _about(self.whole):
                self._fault(seed, how, "repair does not read what SQLite reads")
            return
        if not damaged:
            return
        now = held(study, *_APART)
        if now == self.undisturbed:
            self.tried.repaired += 1
        elif "its clusters" in result.stdout and held(study, *_APART, *_ANALYSED) == self.explored:
            assert cornercase("analyze", study, "--by", "wttc").returncode == 0
            assert cornercase("reduce", study, "-o", study.parent / "reduced").returncode == 0
            if held(study, *_APART, "tallies") == {k: v for k, v in (self.undisturbed or {}).items() if k != "tallies"}:
                self.tried.repaired += 1
            else:
                self._fault(seed, how, "analyze finds something else")
        else:
            self._fault(seed, how, f"repair gives another study: {result.stdout[-300:]}")
        if verify(study).problems:
            self._fault(seed, how, "what was repaired is damaged")

    def _fault(self, seed: int, how: str, what: str) -> None:
        self.tried.faults.append(f"{seed} ({how}): {what}")


def _about(study: Path) -> Any:
    """What SQLite alone reads of what a study is about; None where it cannot."""
    try:
        with closing(sqlite3.connect(study)) as connection:
            return connection.execute("SELECT * FROM meta ORDER BY key").fetchall()
    except (sqlite3.Error, UnicodeDecodeError):
        return None


def _told(study: Path) -> tuple[str, ...]:
    try:
        return verify(study).problems
    except cc.InputError as error:
        return (str(error),)


def _timeless(said: str) -> dict[str, Any]:
    """What `show --json` tells, but how long things took and where the file lies."""
    told = json.loads(said)
    return {key: value for key, value in told.items() if key not in ("seconds", "scenario")}


def _files(folder: Path) -> dict[str, bytes]:
    return {str(one.relative_to(folder)): one.read_bytes() for one in sorted(folder.rglob("*")) if one.is_file()}
