"""Pictures for docs/report.md, docs/compare.md, docs/guide/kinds.md and docs/guide/threshold.md, and the README's film.

    python docs/pictures.py [--x STUDY.db] [--four STUDY.db] [--only TEXT]…

Pictures of pages need Chromium: the one of ``CORNERCASE_CHROMIUM``, of the PATH, or Playwright's. STUDY.db is that of
`cornercase demo x-intersection`, and one of four parameters; they are made where they are not given. The same studies
and the same Chromium give the same pictures.
"""

from __future__ import annotations

import argparse
import io
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image, ImageSequence

import cornercase as cc

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
sys.path.insert(0, str(ROOT / "tests"))

from browser.conftest import ARGUMENTS, SETTLED, find_chromium  # noqa: E402

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from playwright.sync_api import Browser, Page

RANGES = ("ego_start=20:80", "pedestrian_wait=2:10", "p1_speed=6:12", "ego_speed=7:13")
# Second of the film at which something begins to happen.
FILM_BEGINS_AT = 5
THRESHOLDS = (1.0, 0.5, 0.2)
# Where the ego and the pedestrian meet.
BRUSH = "() => cornercase.store.setRanges([['parameter ego_start', 45, 70], ['parameter pedestrian_wait', 5, 9]])"


def write_picture(data: bytes, name: str) -> None:
    """Write a PNG with a palette: what the page draws has few colours, and so a third of the bytes."""
    picture = Image.open(io.BytesIO(data)).convert("RGB").quantize(256, dither=Image.Dither.NONE)
    picture.save(IMAGES / f"{name}.png", optimize=True)
    print(f"{name}.png: {(IMAGES / f'{name}.png').stat().st_size / 1000:.0f} kB")


@contextmanager
def opened(browser: Browser, report: Path, fragment: str = "", **options: Any) -> Iterator[Page]:
    """The page of a study, ready, with what needs time drawn."""
    settings: dict[str, Any] = {
        "viewport": {"width": 1600, "height": 1000},
        "color_scheme": "light",
        "reduced_motion": "reduce",
    }
    with browser.new_context(**(settings | options)) as context:
        page = context.new_page()
        page.goto(f"{report.as_uri()}{fragment}")
        page.wait_for_selector("html[data-ready]")
        for view in page.locator("figure.view").all():
            view.scroll_into_view_if_needed()
            page.evaluate(SETTLED)
        page.wait_for_timeout(1500)
        page.evaluate("() => scrollTo(0, 0)")
        page.evaluate(SETTLED)
        yield page


def take_element(page: Page, selector: str, name: str) -> None:
    """Take a picture of a part of the page."""
    part = page.locator(selector)
    part.scroll_into_view_if_needed()
    page.evaluate(SETTLED)
    page.mouse.move(0, 0)
    write_picture(part.screenshot(animations="disabled"), name)


def take_x(browser: Browser, study: Path, folder: Path, wanted: Callable[[str], bool]) -> None:
    """Take the pictures of the X-intersection."""
    report = cc.write_report(study, folder / "x.html")
    if wanted("report"):
        with opened(browser, report) as page:
            write_picture(page.screenshot(animations="disabled"), "report")
    if wanted("report-dark"):
        with opened(browser, report, color_scheme="dark") as page:
            write_picture(page.screenshot(animations="disabled"), "report-dark")
    if wanted("report-phone"):
        with opened(browser, report, viewport={"width": 400, "height": 800}) as page:
            page.locator("#view-space").evaluate("(one) => one.scrollIntoView()")
            page.evaluate(SETTLED)
            write_picture(page.screenshot(animations="disabled"), "report-phone")
    with opened(browser, report) as page:
        for part in ("courses", "kernel", "histogram", "search", "matters", "coverage", "table"):
            if wanted(f"report-{part}") and page.locator(f"#view-{part}").count():
                take_element(page, f"#view-{part}", f"report-{part}")
        if wanted("report-answers"):
            take_element(page, "#answers", "report-answers")
        if wanted("report-brush"):
            page.evaluate(BRUSH)
            page.locator("#filters").scroll_into_view_if_needed()
            page.evaluate(SETTLED)
            box = page.locator("#scenarios").bounding_box()
            assert box is not None
            top = max(box["y"], 0)
            clip: Any = box | {"y": top, "height": 1000 - top}
            write_picture(page.screenshot(clip=clip, animations="disabled"), "report-brush")
            page.locator("#reset-filters").click()
        if wanted("report-replay"):
            page.locator("#neighbour").click()
            page.wait_for_selector("#replay [data-replay=beside][data-time]")
            take_element(page, "#replay", "report-replay")


def take_settings(browser: Browser, study: Path, folder: Path) -> None:
    """Take the picture of the page of the settings."""
    from cornercase.report import write_clustering_settings_page

    page_file = write_clustering_settings_page(study, folder / "settings.html", ["trajectory-distance"])
    with opened(browser, page_file, viewport={"width": 1600, "height": 780}) as page:
        page.select_option("#shown", label="Stability")
        # Gamma 0.5, eps 0.2.
        page.locator("#map tr:nth-child(9) td:nth-child(4)").click()
        page.evaluate(SETTLED)
        write_picture(page.screenshot(animations="disabled"), "settings")


def take_paper(folder: Path) -> None:
    """Take the picture of the paper's figure 5, as docs/report.md says."""
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config
    from cornercase.report import write_paper_figures

    study = folder / "paper.db"
    explore_config(replace(paper_experiment_config("x-intersection"), optimizer="bayes:filling=0"), study)
    for by, gamma, eps in (("ego-trajectory", 2.0, 0.1), ("trajectory-distance", 0.5, 0.2), ("wttc", 1.0, 0.2)):
        cc.analyze(study, by, gamma=gamma, eps=eps, min_samples=6)
    write_paper_figures(study, "scenario-1", folder / "paper")
    write_picture((folder / "paper" / "figure-5.png").read_bytes(), "paper-figure-5")


def take_four(browser: Browser, study: Path, folder: Path) -> None:
    """Take the picture of four parameters."""
    report = cc.write_report(study, folder / "four.html")
    with opened(browser, report) as page:
        take_element(page, "#view-parallel", "report-parallel")


def take_versions(browser: Browser, folder: Path) -> None:
    """Take the picture of a comparison: of the X-intersection's driver, and of one that reacts 0.1 s later."""
    from cornercase.drivers import NORMAL, BehaviourDriver
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config
    from cornercase.report import write_comparison

    studies = folder / "normal.db", folder / "later.db"
    for path, time in zip(studies, (NORMAL.reaction_time, NORMAL.reaction_time + 0.1), strict=True):
        driver = BehaviourDriver(NORMAL._replace(reaction_time=time))
        chosen = replace(
            paper_experiment_config("x-intersection", budget=100, seed=1), optimizer="sobol", drivers={"Ego": driver}
        )
        explore_config(chosen, path)
    scenario = ROOT / "examples" / "x_intersection" / "x_intersection.xosc"
    report = write_comparison(cc.compare(*studies), *studies, folder / "compare.html", scenario=scenario)
    with opened(browser, report) as page:
        write_picture(page.screenshot(animations="disabled"), "compare")


def take_film(folder: Path) -> None:
    """Make the film of the hardest collision at the T-intersection that is the fault of an aggressive ego."""
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config

    path = folder / "aggressive.db"
    explore_config(paper_experiment_config("t-intersection", driver="aggressive"), path)
    study = cc.Study.open(path)
    worst = study.most_critical(20)
    film = study.replay(int(worst.index[worst["fault"] == "ego"][0]), folder / "film.gif")
    with Image.open(film) as whole:
        milliseconds = int(whole.info["duration"])
        frames = [frame.convert("RGB") for frame in ImageSequence.Iterator(whole)]
    frames = frames[FILM_BEGINS_AT * 1000 // milliseconds :]
    # With the palette of the last frame, which has the mark of the collision, what stands still keeps its colour.
    palette = frames[-1].quantize(255, dither=Image.Dither.NONE)
    frames = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [milliseconds] * (len(frames) - 1) + [2500]
    target = IMAGES / "collision.gif"
    frames[0].save(target, save_all=True, append_images=frames[1:], duration=durations, loop=0)
    print(f"{target.name}: {target.stat().st_size / 1000:.0f} kB")


def take_threshold(folder: Path) -> None:
    """Draw what three thresholds make critical of the X-intersection, from scenarios that are spread evenly."""
    import matplotlib.pyplot as plt

    files = ROOT / "examples" / "x_intersection"
    path = folder / "threshold.db"
    cc.explore(
        files / "x_intersection.xosc",
        path,
        space=files / "x_intersection.space.xosc",
        ego="Ego",
        other="Pedestrian",
        metrics=["wttc"],
        optimizer="sobol",
        budget=512,
        seed=1,
    )
    table = cc.Study.open(path).table()
    scores = table["wttc"]

    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 3), layout="constrained")
    left.hist(scores, bins=40, color="#0b57a4")
    left.set(xlabel="wttc [s]", ylabel="number of scenarios")
    right.plot(sorted(scores), [100 * (i + 1) / len(scores) for i in range(len(scores))], color="#0b57a4")
    right.set(xlabel="threshold of wttc [s]", ylabel="critical [%]", ylim=(0, 100))
    for axes in (left, right):
        for threshold in THRESHOLDS:
            axes.axvline(threshold, color="#b3261e", linestyle="--", linewidth=1)
    save_figure(figure, folder, "threshold-scores")

    figure, panels = plt.subplots(1, len(THRESHOLDS), figsize=(9, 3.2), layout="constrained", sharey=True)
    for axes, threshold in zip(panels, THRESHOLDS, strict=True):
        critical = scores <= threshold
        for mask, colour, marker in ((~critical, "#9aa3ab", "."), (critical, "#b3261e", "x")):
            axes.scatter(table["ego_start"][mask], table["pedestrian_wait"][mask], s=14, c=colour, marker=marker)
        axes.set(title=f"wttc ≤ {threshold:g} s: {100 * critical.mean():.0f} % critical", xlabel="ego_start [m]")
    panels[0].set_ylabel("pedestrian_wait [s]")
    save_figure(figure, folder, "threshold-space")


def save_figure(figure: Figure, folder: Path, name: str) -> None:
    """Write a figure as the other pictures."""
    figure.savefig(folder / f"{name}.png", dpi=120)
    write_picture((folder / f"{name}.png").read_bytes(), name)


def study_of_x(path: Path) -> Path:
    """The demonstration, as its command makes it."""
    from cornercase.exploration._explore import explore_config
    from cornercase.exploration._paper_examples import paper_experiment_config

    configuration = paper_experiment_config("x-intersection")
    explore_config(configuration, path)
    cc.analyze(path)
    cc.reduce(path, path.parent / "reduced", scenario=configuration.logical.scenario_file)
    return path


def study_of_four(path: Path) -> Path:
    """Four parameters."""
    cc.explore(
        ROOT / "examples" / "x_intersection" / "x_intersection.xosc",
        path,
        ego="Ego",
        other="Pedestrian",
        metrics=["wttc"],
        ranges=RANGES,
        optimizer="level-set",
        budget=200,
    )
    cc.analyze(path)
    return path


def main() -> int:
    """Take all pictures, or those that are asked for."""
    from playwright.sync_api import sync_playwright

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--x", type=Path, metavar="STUDY.db", help="of the demonstration")
    parser.add_argument("--four", type=Path, metavar="STUDY.db", help="of four parameters")
    parser.add_argument("--only", action="append", metavar="TEXT", help="pictures of these names")
    options = parser.parse_args()

    def wanted(name: str) -> bool:
        return not options.only or name in options.only

    with tempfile.TemporaryDirectory() as temporary, sync_playwright() as driver, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        folder = Path(temporary)
        if wanted("collision"):
            take_film(folder)
        if wanted("threshold"):
            take_threshold(folder)
        if options.only and set(options.only) <= {"collision", "threshold"}:
            return 0
        path = find_chromium(Path(driver.chromium.executable_path))
        if path is None:
            parser.error("there is no Chromium: install it, or name it in CORNERCASE_CHROMIUM.")
        with driver.chromium.launch(executable_path=path, args=list(ARGUMENTS)) as browser:
            if wanted("compare"):
                take_versions(browser, folder)
            if wanted("paper-figure-5"):
                take_paper(folder)
            if options.only and set(options.only) <= {"compare", "paper-figure-5"}:
                return 0
            study = options.x or study_of_x(folder / "x.db")
            take_x(browser, study, folder, wanted)
            if wanted("settings"):
                take_settings(browser, study, folder)
            if wanted("report-parallel"):
                take_four(browser, options.four or study_of_four(folder / "four.db"), folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
