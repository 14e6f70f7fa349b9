"""A browser, pages of small studies, and a tab that lets nothing pass which a user should not meet."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from filelock import FileLock

import cornercase as cc
from browser.studies import MAKERS, made
from conftest import at_night, without

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Page

# Without what Chromium does by itself over the network, and without looking for a graphics card.
ARGUMENTS = (
    "--disable-gpu",
    "--no-sandbox",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
OWN = ("file:", "data:", "blob:", "about:", "http://127.0.0.1:")
# As in the page's own words: what a view has to say after a change is drawn in the next frame or the one after.
SETTLED = "() => new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => setTimeout(done, 30))))"


def find_chromium(own: Path) -> str | None:
    """The one that is named, the machine's, or Playwright's own."""
    named = os.environ.get("CORNERCASE_CHROMIUM")
    if named:
        return named
    for name in ("chromium", "chromium-browser", "google-chrome"):
        if (found := shutil.which(name)) is not None:
            return found
    return str(own) if own.exists() else None


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Try a test once more: on a machine that others load, a browser draws late now and then."""
    for item in items:
        if Path(__file__).parent in item.path.parents:
            item.add_marker(pytest.mark.flaky(reruns=1))


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium, or a skip that says how to get it; a failure in CI."""
    try:
        from playwright import sync_api as playwright
    except ModuleNotFoundError:
        without("playwright is not installed: run `pip install -e '.[dev]'`")
    with playwright.sync_playwright() as driver:
        path = find_chromium(Path(driver.chromium.executable_path))
        if path is None:
            without("there is no Chromium: install it, or name it in CORNERCASE_CHROMIUM")
        with driver.chromium.launch(executable_path=path, args=list(ARGUMENTS)) as chromium:
            yield chromium


@pytest.fixture
def studies(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """By name, studies that all workers share; only to be read."""
    return lambda name: shared(tmp_path_factory, name)[0]


@pytest.fixture
def reports(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    """Addresses of the reports of these studies."""
    return lambda name: shared(tmp_path_factory, name)[1].as_uri()


def shared(factory: pytest.TempPathFactory, name: str) -> tuple[Path, Path]:
    base = factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "studies"
    folder.mkdir(exist_ok=True)
    with FileLock(folder / f"{name}.lock"):
        place = folder / f"{name}.path"
        if not place.exists():
            path = made(folder, name)
            report = cc.write_report(path, path.with_suffix(".html"))
            place.write_text(f"{path}\n{report}", encoding="utf-8")
        study, page = place.read_text(encoding="utf-8").splitlines()
    return Path(study), Path(page)


class Tab:
    """A tab of the browser, and what it did that it should not."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.faults: list[str] = []
        page.on("console", lambda message: self._hear(message.type, message.text))
        page.on("pageerror", lambda error: self.faults.append(f"error: {error}"))
        page.on("request", lambda request: self._see(request.url))

    def _hear(self, kind: str, text: str) -> None:
        # A page that is still there when its server ends asks it again.
        if kind in ("error", "warning") and "ERR_CONNECTION_REFUSED" not in text:
            self.faults.append(f"{kind} on the console: {text}")

    def _see(self, url: str) -> None:
        if not url.startswith(OWN):
            self.faults.append(f"request: {url[:200]}")

    def open(self, address: str) -> Page:
        """Open a report, and wait until it can be used."""
        self.page.goto(address)
        self.page.wait_for_selector("html[data-ready]", timeout=120_000)
        self.settle()
        return self.page

    def settle(self) -> None:
        """Wait until what changed is drawn."""
        self.page.evaluate(SETTLED)


@pytest.fixture(scope="session")
def context(browser: Browser) -> Iterator[BrowserContext]:
    """What all tabs share: one of its own for each would take as long as the page itself."""
    with browser.new_context() as one:
        one.set_default_timeout(10_000)
        yield one


@pytest.fixture
def tab(context: BrowserContext) -> Iterator[Tab]:
    """A tab that fails the test on a message on the console, an error, or a request to anywhere else."""
    page = context.new_page()
    page.set_viewport_size({"width": 1280, "height": 900})
    # What another test's page has kept, as notes or a theme.
    everything = {"origin": "file://", "storageTypes": "all"}
    context.new_cdp_session(page).send("Storage.clearDataForOrigin", everything)
    one = Tab(page)
    yield one
    page.close()
    assert one.faults == []


@pytest.fixture(params=at_night(sorted(MAKERS), {*MAKERS} - {"hostile", "failed"}))
def each(request: pytest.FixtureRequest) -> str:
    """Name of each study."""
    return str(request.param)
