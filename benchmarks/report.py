"""How soon the report of a study can be used in a browser, and how soon it answers.

    python benchmarks/report.py [--quick] [--folder FOLDER] [--sizes N,…] [--json FILE]

The studies are of the X-intersection, searched by ``sobol``; the one of 400 scenarios is analysed and reduced too. They
and their reports are kept in FOLDER where one is given, so that they are made once. The columns:

- ``MB``: of the file, in 10^6 bytes; ``write s``: of CPU, to write it, with the start of the process; ``GB``: that it
  held;
- ``usable s``: from the request to ``data-ready``, with the views drawn that are on the screen; the median of loads in
  tabs of their own;
- ``brush ms``: from the movement of the mouse in the parameter space until all views on the screen have drawn what it
  left, and the browser has painted it; the median and the worst of 20 brushes;
- ``heap MB`` of JavaScript, after those brushes.

Beside each stands a bare figure of the same points, in two coordinates and the score, as ``plotly.io.to_html`` writes
it: without recordings, and with nothing that follows its brush. Chromium is the one of ``CORNERCASE_CHROMIUM``, of the
PATH, or Playwright's; it runs on 2 cores.
"""

from __future__ import annotations

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cornercase as cc
from cornercase.study import StudyFile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tests"))

from browser.conftest import ARGUMENTS, find_chromium  # noqa: E402

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

EXAMPLE = ROOT / "examples" / "x_intersection" / "x_intersection"
# Of a file in MB, seconds until it can be used, ms from a brush to the answer; by scenarios.
GOALS = {400: (8.0, 1.5, None), 20_000: (30.0, 4.0, 150.0)}
ANALYSED = 2_000
BRUSHES = 20
PAINTED = "() => new Promise((done) => requestAnimationFrame(() => setTimeout(done)))"
# The clock starts with what the hand did, not when the page got around to it.
LISTEN = """() => {
  window.answers = [];
  let moved = 0;
  const hear = (event) => { moved = event.timeStamp; };
  for (const name of ["pointerdown", "pointermove", "pointerup"]) addEventListener(name, hear, true);
  window.cornercase.store.on("shown", async () => {
    const from = moved;
    await window.cornercase.settled();
    requestAnimationFrame(() => setTimeout(() => window.answers.push(performance.now() - from)));
  });
}"""
READY = """async () => {
  const root = document.documentElement;
  if (!root.dataset.ready) {
    await new Promise((done) => new MutationObserver((_, observer) => {
      if (root.dataset.ready) { observer.disconnect(); done(); }
    }).observe(root, { attributes: true }));
  }
  await window.cornercase.settled();
  await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
  return performance.now();
}"""
# A figure is drawn again for each brush, as Plotly does when points are selected.
PEER = """async (brushes) => {
  const plot = document.querySelector(".plotly-graph-div");
  const x = plot.data[0].x._inputArray ?? plot.data[0].x;
  const [low, high] = [Math.min(...x), Math.max(...x)];
  const answers = [];
  for (let k = 0; k < brushes; k++) {
    const edge = low + (high - low) * (k + 1) / (brushes + 1);
    const picked = [];
    const from = performance.now();
    for (let j = 0; j < x.length; j++) if (x[j] <= edge) picked.push(j);
    await Plotly.restyle(plot, { selectedpoints: [picked] });
    await new Promise((done) => requestAnimationFrame(() => setTimeout(done)));
    answers.push(performance.now() - from);
  }
  return answers;
}"""
DRAWN = """() => new Promise((done) => {
  const look = () => document.querySelector(".plotly-graph-div .main-svg, .plotly-graph-div .gl-container")
    ? requestAnimationFrame(() => setTimeout(() => done(performance.now()))) : setTimeout(look, 5);
  look();
})"""


def study_of(folder: Path, count: int) -> Path:
    """A study of so many scenarios, made if it is not there."""
    path = folder / f"{count}.db"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        cc.explore(
            None,
            path,
            space=f"{EXAMPLE}.space.xosc",
            ego="Ego",
            other="Pedestrian",
            metrics=["wttc", "trajectory-distance"],
            optimizer="sobol",
            budget=count,
            batch=100,
        )
        with StudyFile.open(path, readonly=False) as study:
            if count <= ANALYSED and not study.analyzed_aspects():
                cc.analyze(study)
                cc.reduce(study, folder / f"{count}-reduced", scenario=f"{EXAMPLE}.xosc")
    return path


def written(study: Path) -> dict[str, float]:
    """Write a report in a process of its own: seconds of CPU, and the most memory in GB."""
    program = "import sys, cornercase as cc; cc.write_report(sys.argv[1], sys.argv[2])"
    page = study.with_suffix(".html")
    before = os.times()
    process = subprocess.Popen([sys.executable, "-c", program, str(study), str(page)])
    _, status, used = os.wait4(process.pid, 0)
    if status != 0:
        raise SystemExit(f"The report of {study} could not be written.")
    after = os.times()
    cpu = after.children_user + after.children_system - before.children_user - before.children_system
    return {"MB": page.stat().st_size / 1e6, "write": cpu, "GB": memory(used)}


def memory(used: resource.struct_rusage) -> float:
    return used.ru_maxrss * (1 if sys.platform == "darwin" else 1024) / 1e9


def bare_figure(study: Path) -> Path:
    """The same points as a figure that does nothing else."""
    import plotly.graph_objects as go
    from plotly.io import to_html

    with StudyFile.open(study, readonly=True) as opened:
        table = opened.table()
    kind = go.Scattergl if len(table) > 1000 else go.Scatter
    marker = {"color": table["wttc"].tolist(), "colorscale": "Viridis", "showscale": True}
    points = kind(x=table["ego_start"].tolist(), y=table["pedestrian_wait"].tolist(), mode="markers", marker=marker)
    page = study.with_suffix(".plotly.html")
    page.write_text(to_html(go.Figure(points), include_plotlyjs=True), encoding="utf-8")
    return page


def heap(page: Page) -> float:
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    session.send("Performance.enable")
    found = {one["name"]: one["value"] for one in session.send("Performance.getMetrics")["metrics"]}
    return float(found["JSHeapUsedSize"]) / 1e6


def opened(browser: Browser, path: Path, script: str, loads: int) -> tuple[Page, list[float]]:
    """The page in a tab, and the seconds that it took each time."""
    seconds = []
    for k in range(loads):
        page = browser.new_context(viewport={"width": 1600, "height": 1000}).new_page()
        page.goto(path.as_uri(), wait_until="commit")
        seconds.append(page.evaluate(script) / 1e3)
        if k < loads - 1:
            page.context.close()
    return page, seconds


def brushed(page: Page) -> list[float]:
    """Milliseconds from each movement that changed what is shown until all of it was drawn."""
    page.evaluate(LISTEN)
    plot = page.locator("#view-space .plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    assert box is not None
    left, top = box["x"] + 0.3 * box["width"], box["y"] + 0.2 * box["height"]
    page.mouse.move(left, top)
    page.mouse.down()
    page.mouse.move(left + 0.05 * box["width"], top + 0.1 * box["height"])
    page.evaluate("() => { window.answers.length = 0; }")
    for k in range(BRUSHES):
        share = (k + 1) / BRUSHES
        known = page.evaluate("() => window.answers.length")
        page.mouse.move(left + (0.05 + 0.5 * share) * box["width"], top + (0.1 + 0.5 * share) * box["height"])
        page.wait_for_function("(known) => window.answers.length > known", arg=known)
    page.mouse.up()
    page.evaluate(PAINTED)
    answers: list[float] = page.evaluate("() => window.answers")
    return answers[:BRUSHES]


def measured(browser: Browser, folder: Path, count: int, loads: int) -> Iterator[dict[str, Any]]:
    study = study_of(folder, count)
    row: dict[str, Any] = {"page": "report", "scenarios": count, **written(study)}
    page, seconds = opened(browser, study.with_suffix(".html"), READY, loads)
    answers = brushed(page)
    yield row | {"usable": seconds, "brush": answers, "heap": heap(page)}
    page.context.close()
    bare = bare_figure(study)
    page, seconds = opened(browser, bare, DRAWN, loads)
    answers = page.evaluate(PEER, BRUSHES)
    yield {
        "page": "bare figure", "scenarios": count, "MB": bare.stat().st_size / 1e6, "usable": seconds, "brush": answers,
        "heap": heap(page),
    }  # fmt: skip
    page.context.close()


def told(row: dict[str, Any]) -> str:
    size, usable, brush = GOALS.get(row["scenarios"], (None, None, None)) if row["page"] == "report" else (None,) * 3
    cells = [
        f"{row['MB']:.1f}" + ("" if size is None else f" (< {size:g})"),
        f"{row['write']:.1f}" if "write" in row else "",
        f"{row['GB']:.2f}" if "GB" in row else "",
        f"{statistics.median(row['usable']):.2f}" + ("" if usable is None else f" (<= {usable:g})"),
        f"{statistics.median(row['brush']):.0f}, {max(row['brush']):.0f}"
        + ("" if brush is None else f" (<= {brush:g})"),
        f"{row['heap']:.0f}",
    ]
    return f"{row['scenarios']:>9}  {row['page']:12}" + "".join(f"{cell:>18}" for cell in cells)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="60 and 1,000 scenarios, three loads")
    parser.add_argument("--folder", type=Path, help="where studies and reports are kept")
    parser.add_argument("--sizes", metavar="N,…", help="scenarios of the studies")
    parser.add_argument("--json", type=Path, metavar="FILE")
    options = parser.parse_args()
    sizes = [int(one) for one in (options.sizes or ("60,1000" if options.quick else "400,20000")).split(",")]
    from playwright.sync_api import sync_playwright

    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:2])
    table = []
    titles = ("MB", "write s", "GB", "usable s", "brush ms", "heap MB")
    print(f"{'scenarios':>9}  {'page':12}" + "".join(f"{one:>18}" for one in titles))
    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as driver:
        folder = options.folder or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        path = find_chromium(Path(driver.chromium.executable_path))
        if path is None:
            print("There is no Chromium: install it, or name it in CORNERCASE_CHROMIUM.")
            return 0
        with driver.chromium.launch(executable_path=path, args=list(ARGUMENTS)) as browser:
            for count in sizes:
                for row in measured(browser, folder, count, 3 if options.quick else 5):
                    print(told(row), flush=True)
                    table.append(row)
    if options.json:
        options.json.write_text(json.dumps(table, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
