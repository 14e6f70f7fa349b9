"""The page on which gamma and eps are chosen, as `cornercase analyze --explore-settings` writes it."""

from __future__ import annotations

import shlex
import shutil

import pytest
from axe_playwright_python.sync_playwright import Axe  # type: ignore[import-untyped]

from browser.conftest import shared
from conftest import at_night
from cornercase.clustering import read_analysis
from cornercase.clustering._settings_map import EPS, GAMMAS
from cornercase.report import write_clustering_settings_page
from cornercase.study import StudyFile
from helpers.command_line import cornercase

ASPECTS = ("interaction", "wttc")


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    study, _ = shared(tmp_path_factory, "plain")
    return study, write_clustering_settings_page(study, tmp_path_factory.mktemp("settings") / "page.html", ASPECTS)


def cell(page, gamma, eps):
    return page.locator(f"#map tr:nth-child({EPS.index(eps) + 2}) td:nth-child({GAMMAS.index(gamma) + 2})")


def test_a_click_takes_a_setting_and_its_command_finds_these_clusters(tab, plain, tmp_path):
    study, file = plain
    page = tab.open(file.as_uri())
    page.select_option("#aspect", label="wttc")
    page.select_option("#points", label="3")
    cell(page, 1.0, 0.1).click()
    assert cell(page, 1.0, 0.1).get_attribute("aria-selected") == "true"
    command = page.locator("#command code").inner_text()
    assert command == f"cornercase analyze {study.name} --by wttc --gamma 1 --eps 0.1 --min-samples 3"
    copy = shutil.copy(study, tmp_path / study.name)
    assert cornercase(*shlex.split(command)[1:2], copy, *shlex.split(command)[3:]).returncode == 0
    with StudyFile.open(copy, readonly=True) as opened:
        analysis = read_analysis(opened, "wttc")
    labels = page.evaluate(
        "() => [...cornercase.settings.aspect.taken().labels].map((one) => (one === 255 ? -1 : one))"
    )
    assert labels == analysis.labels.tolist()
    noise = int((analysis.labels < 0).sum())
    sizes = [str(size) for size in [*analysis.sizes, *([noise] if noise else [])]]
    assert page.locator("#clusters tbody td:nth-child(2)").all_inner_texts() == sizes
    assert page.locator("#taken-title").inner_text().endswith(f"{noise} of {len(labels)} noise")
    # Each scenario is in both pictures.
    for picture in ("space", "kernel"):
        assert page.locator(f"#{picture} .mark").count() == len(labels)
    # Marked where the command put it.
    write_clustering_settings_page(copy, tmp_path / "again.html", ["wttc"])
    again = tab.open((tmp_path / "again.html").as_uri())
    assert "stored in the study" in cell(again, 1.0, 0.1).get_attribute("aria-label")
    assert cell(again, 1.0, 0.1).get_attribute("aria-selected") == "true"


def test_the_study_s_own_setting_comes_first_and_the_outcome_is_warned_of(tab, plain):
    page = tab.open(plain[1].as_uri())
    with StudyFile.open(plain[0], readonly=True) as opened:
        stored = read_analysis(opened, "interaction").labels
    taken = "() => [...cornercase.settings.aspect.taken().labels].map((one) => (one === 255 ? -1 : one))"
    assert page.evaluate(taken) == stored.tolist()
    assert page.locator("#own").get_attribute("aria-pressed") == "true"
    assert page.locator("#copy").is_disabled()
    cell(page, 5.0, 0.3).click()
    page.locator("#own").click()
    assert page.evaluate(taken) == stored.tolist()
    assert "no evidence" in page.locator("#warning").inner_text()


def test_the_map_shows_each_score(tab, plain):
    page = tab.open(plain[1].as_uri())
    page.select_option("#aspect", label="wttc")
    titles = page.locator("#shown option").all_inner_texts()
    assert titles[:4] == ["Number of clusters", "Noise [%]", "Stability", "Agreement with the outcome"]
    assert "Explained variance of wttc [%]" in titles
    for title in titles:
        page.select_option("#shown", label=title)
        assert page.locator("#map-title").inner_text() == title
        assert page.locator("#map-caption").inner_text()
        numbers = page.locator("#map td").all_inner_texts()
        assert len(numbers) == len(GAMMAS) * len(EPS)
        assert len(set(numbers)) > 2


def test_arrow_keys_take_the_next_setting(tab, plain):
    page = tab.open(plain[1].as_uri())
    cell(page, 1.0, 0.1).click()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowDown")
    assert "--gamma 2 --eps 0.15 " in page.locator("#command code").inner_text()
    assert cell(page, 2.0, 0.15).evaluate("(one) => one === document.activeElement")
    page.keyboard.press("End")
    page.keyboard.press("ArrowRight")
    assert "--gamma 100 --eps 0.15 " in page.locator("#command code").inner_text()
    # One cell is reached by Tab.
    assert page.locator("#map td[tabindex='0']").count() == 1
    assert page.locator("#told").inner_text() == page.locator("#taken-title").inner_text()


LOOKS = [("dark", 400), ("light", 400), ("light", 1280), ("dark", 1280)]


@pytest.mark.parametrize("looks", at_night(LOOKS, LOOKS[1:]))
def test_settings_for_everyone(tab, plain, looks):
    page = tab.open(plain[1].as_uri())
    cell(page, 1.0, 0.1).click()
    scheme, width = looks
    page.emulate_media(color_scheme=scheme)
    page.set_viewport_size({"width": width, "height": 900})
    tab.settle()
    assert page.evaluate("() => document.documentElement.scrollWidth") <= width
    for shown in page.locator("#shown option").all_inner_texts():
        page.select_option("#shown", label=shown)
        found = Axe().run(page).response["violations"]
        serious = [one for one in found if one["impact"] in ("serious", "critical")]
        told = [(one["id"], one["help"], [node["html"][:200] for node in one["nodes"][:4]]) for one in serious]
        assert told == [], shown


def test_names_are_text_and_the_page_is_the_same_again(tab, studies, tmp_path):
    study = studies("hostile")
    file = write_clustering_settings_page(study, tmp_path / "one.html", ["wttc"])
    page = tab.open(file.as_uri())
    assert page.title().startswith("cornercase: Settings of the clustering: ")
    cell(page, 1.0, 0.1).click()
    words = shlex.split(page.locator("#command code").inner_text())
    assert words[:5] == ["cornercase", "analyze", study.name, "--by", "wttc"]
    assert write_clustering_settings_page(study, tmp_path / "other.html", ["wttc"]).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("name", at_night(["failed", "four"], {"four"}))
def test_other_studies_have_it_too(tab, studies, tmp_path, name):
    by = ["distance"] if name == "failed" else ["wttc"]
    page = tab.open(write_clustering_settings_page(studies(name), tmp_path / "page.html", by).as_uri())
    cell(page, 1.0, 0.1).click()
    page.select_option("#up", index=0)
    assert page.locator("#space .mark").count() > 0
