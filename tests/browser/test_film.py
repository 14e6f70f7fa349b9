"""The replay is saved as a film from the page, and where a browser cannot, there is no button."""

from __future__ import annotations


def test_a_replay_is_saved_as_a_film(tab, reports, tmp_path):
    page = tab.open(f"{reports('plain')}#id=12")
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    button = page.locator("#film")
    assert button.is_visible()
    page.locator("#speed").select_option("4")
    with page.expect_download(timeout=90_000) as coming:
        button.click()
    assert coming.value.suggested_filename == "scenario-12.webm"
    path = tmp_path / "film.webm"
    coming.value.save_as(path)
    content = path.read_bytes()
    assert content[:4] == b"\x1aE\xdf\xa3", "no WebM"
    assert len(content) > 5000
    page.wait_for_selector("#film[aria-pressed=false]")
    # It has played to its end.
    assert page.evaluate("() => cornercase.replay.clock.time === cornercase.replay.clock.end")


def test_a_second_click_ends_a_film(tab, reports):
    page = tab.open(f"{reports('plain')}#id=12")
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    page.locator("#speed").select_option("0.25")
    with page.expect_download(timeout=30_000):
        page.locator("#film").click()
        page.wait_for_timeout(1000)
        # A click of the mouse waits for a page that is still, which it is not while it films on a busy machine.
        page.evaluate("() => document.querySelector('#film').click()")
    page.wait_for_selector("#film[aria-pressed=false]")
    assert page.evaluate("() => !cornercase.replay.clock.playing")


def test_there_is_no_button_where_a_browser_cannot(tab, reports):
    tab.page.add_init_script("delete window.MediaRecorder")
    page = tab.open(f"{reports('plain')}#id=12")
    page.wait_for_selector("#replay [data-replay=selected][data-time]")
    assert page.locator("#film").is_hidden()
