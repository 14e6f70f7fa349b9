"""Runs the family, and tells for which reconstructions each statement holds."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from benchmarks.replication.causes import rules_state
from benchmarks.replication.family import DEFAULTS, READINGS, RUNS, Runs
from benchmarks.replication.observed import ASPECTS_OF, Observed
from benchmarks.replication.statements import STATEMENTS, Statement

from cornercase.exploration._config import ExplorationConfig
from cornercase.exploration._explore import explore_config

Cell = dict[str, Any]
Results = dict[tuple[str, str, str], list[Cell]]
"""By number of the statement, runs and reading: figures and answer for each seed."""

CONFIRMED: Final = "confirmed"
SOME: Final = "for some"
NONE: Final = "for none"
# Of ten seeds.
ENOUGH: Final = 0.8
BEGIN, END = "<!-- statements: begin -->", "<!-- statements: end -->"
_SOURCES: Final = ("observed.py", "statements.py")
# Statements whose answers depend on the fault rules.
_JUDGED: Final = "2.4"


def run_family(
    folder: Path, seeds: Sequence[int], numbers: Sequence[str], budget: int | None, progress: bool
) -> Results:
    """Explore what is not explored yet, and test the statements; what is tested already is read."""
    results: Results = {}
    folder.mkdir(parents=True, exist_ok=True)
    wanted = [STATEMENTS[number] for number in numbers]
    for seed in seeds:
        for runs in RUNS:
            for ego in runs.egos:
                asked = [one for one in wanted if (one.scenario, one.ego) == (runs.scenario, ego)]
                if not asked:
                    continue
                cells = _cells(runs, ego, seed, folder, asked, budget, progress)
                for (number, reading), cell in cells.items():
                    results.setdefault((number, runs.name, reading), []).append(cell)
    return results


def _cells(
    runs: Runs, ego: str, seed: int, folder: Path, asked: list[Statement], budget: int | None, progress: bool
) -> dict[tuple[str, str], Cell]:
    """Figures and answer of each statement and reading, of one study."""
    path = folder / f"{runs.name}-{ego or 'file'}-{seed}.db"
    known = path.with_suffix(".json")
    config = runs.config(ego, seed, budget, folder)
    roads = road_file(config)
    state, judged = _state(runs), rules_state(roads)
    stored = json.loads(known.read_text()) if known.exists() else {}
    cells: dict[str, Cell] = stored["cells"] if stored.get("state") == state else {}
    if stored.get("judged") != judged:
        cells = {key: cell for key, cell in cells.items() if not key.startswith(_JUDGED)}
    keys = [(one, reading) for reading in READINGS if reading.name in runs.readings for one in asked]
    if not all(f"{one.number}/{reading.name}" in cells for one, reading in keys):
        explore_config(config, path, progress=progress)
        observed = Observed.read(path, seed, ASPECTS_OF[runs.scenario], roads)
        for one, reading in keys:
            if f"{one.number}/{reading.name}" in cells:
                continue
            figures, holds = one.measure(observed, reading)
            cells[f"{one.number}/{reading.name}"] = {"figures": figures, "holds": bool(holds)}
        known.write_text(json.dumps({"state": state, "judged": judged, "cells": cells}))
        if progress:
            print(f"{path.stem}: {sum(cell['holds'] for cell in cells.values())} of {len(cells)} hold", flush=True)
    return {(one.number, reading.name): cells[f"{one.number}/{reading.name}"] for one, reading in keys}


def road_file(config: ExplorationConfig) -> Path:
    """Return the road file of a configuration's scenario."""
    path = config.logical.scenario_file.road_path_for()
    if path is None:
        raise ValueError(f"{config.logical.path}: has no road file")
    return path.resolve()


def _state(runs: Runs) -> str:
    """Checksum of what answers depend on beside the study: measures, and settings of the aspects that are needed."""
    here = Path(__file__).parent
    aspects = ASPECTS_OF[runs.scenario]
    readings = [
        (one, {by: one.settings[by] for by in aspects} if one.settings else None)
        for one in (replace(one, says="") for one in READINGS if one.name in runs.readings)
    ]
    told = repr([(replace(one, settings=None), settings) for one, settings in readings]).encode()
    return hashlib.sha256(b"".join([*((here / name).read_bytes() for name in _SOURCES), told])).hexdigest()


def holds(cells: list[Cell]) -> bool:
    return bool(cells) and sum(cell["holds"] for cell in cells) >= ENOUGH * len(cells)


def verdict(number: str, results: Results) -> tuple[str, list[tuple[str, str]]]:
    """Return the verdict, and the reconstructions in which the statement holds."""
    default = DEFAULTS[STATEMENTS[number].scenario]
    where = [key[1:] for key, cells in results.items() if key[0] == number and holds(cells)]
    return CONFIRMED if default in where else SOME if where else NONE, where


def describe(cells: list[Cell]) -> str:
    """Median and range of each figure over the seeds."""
    names = list(dict.fromkeys(name for cell in cells for name in cell["figures"]))
    parts = []
    for name in names:
        values = np.array([cell["figures"][name] for cell in cells if name in cell["figures"]], dtype=np.float64)
        finite = values[np.isfinite(values)]
        if not len(finite):
            parts.append(f"{name} –")
            continue
        low, middle, high = (f"{value:.3g}" for value in np.quantile(finite, (0.0, 0.5, 1.0), method="nearest"))
        parts.append(f"{name} {middle}" if low == high else f"{name} {middle} ({low} to {high})")
    return ", ".join(parts) or "no accidents"


def table(results: Results) -> Iterator[str]:
    """Markdown rows: number, statement, verdict, and where it holds or what was measured by default."""
    yield "| | statement | limit | verdict | measured: median (range), seeds |"
    yield "| --- | --- | --- | --- | --- |"
    for number, one in STATEMENTS.items():
        if not any(key[0] == number for key in results):
            continue
        answer, where = verdict(number, results)
        default = DEFAULTS[one.scenario]
        shown = [default, *([] if answer == CONFIRMED else _first_readings(where))]
        cells = [f"{_name(key)}: {told(results[(number, *key)])}" for key in shown]
        if answer == NONE:
            others = [(key[1:], cells_) for key, cells_ in results.items() if key[0] == number and key[1:] != default]
            if others:
                best, of_best = max(others, key=lambda item: sum(cell["holds"] for cell in item[1]))
                cells.append(f"best of the others, {_name(best)}: {told(of_best)}")
        ego = f"{one.ego} ego: " if one.ego else ""
        yield f"| {number} | {ego}{one.says} | {one.limit} | {answer} | {'; '.join(cells)} |"


def _first_readings(where: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """The first reading of each runs: further ones need not matter to the statement."""
    order = [one.name for one in READINGS]
    first: dict[str, tuple[str, str]] = {}
    for runs, reading in sorted(where, key=lambda key: order.index(key[1])):
        first.setdefault(runs, (runs, reading))
    return list(first.values())


def told(cells: list[Cell]) -> str:
    """Median and range of each figure, and for how many seeds it holds."""
    return f"{describe(cells)}, {sum(cell['holds'] for cell in cells)} of {len(cells)}"


def _name(key: tuple[str, str]) -> str:
    runs, reading = key
    return f"*{runs}*, {reading}"


def reconstructions() -> Iterator[str]:
    """Markdown rows: each reconstruction of a scenario, and each way of comparing and judging."""
    yield "| | what it is |"
    yield "| --- | --- |"
    for runs in RUNS:
        yield f"| *{runs.name}* | {runs.says} |"
    for reading in READINGS:
        yield f"| {reading.name} | {reading.says} |"


def write_table(page: Path, results: Results) -> None:
    """Put the tables between the marks of a page."""
    replace_between(page, BEGIN, END, (*reconstructions(), "", *table(results)))


def replace_between(page: Path, begin: str, end: str, rows: Iterable[str]) -> None:
    """Put rows between two marks of a page."""
    text = page.read_text("utf-8")
    if not (begin in text and end in text):
        raise ValueError(f"{page}: has no marks {begin} and {end}")
    lines = "\n".join((begin, "", *rows, "", end))
    page.write_text(re.sub(f"{re.escape(begin)}.*{re.escape(end)}", lambda _: lines, text, flags=re.DOTALL), "utf-8")
