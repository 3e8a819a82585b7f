"""Pages in a real browser: drawn, without errors, without the network, on a phone and a screen."""

import json
import subprocess
import sys

import pytest
from graph_tools import DEMO, JHU
from real_browser import DRAWN, NEEDED, PHONE, SCREEN, start_browser

pytestmark = [NEEDED, pytest.mark.thorough, pytest.mark.browser]


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    driver = start_browser(tmp_path_factory.mktemp("browser"))
    yield driver
    driver.quit()


def look_at(browser, page, width):
    """Open a page and wait until it is drawn; figures, console errors, and what was asked for."""
    browser.set_window_size(width, 2000)
    for kind in ("browser", "performance"):
        browser.get_log(kind)  # what came before
    browser.get(page.as_uri())
    browser.set_script_timeout(60)
    browser.execute_async_script(
        "const done = arguments[0];"
        "const wait = () => window.Bokeh && Bokeh.documents.length"
        " && Bokeh.documents.every((d) => d.is_idle)"
        " ? requestAnimationFrame(() => requestAnimationFrame(done)) : setTimeout(wait, 50);"
        "wait();"
    )
    errors = [e["message"] for e in browser.get_log("browser") if e["level"] != "INFO"]
    messages = [json.loads(e["message"])["message"] for e in browser.get_log("performance")]
    sent = [m["params"] for m in messages if m["method"] == "Network.requestWillBeSent"]
    return browser.execute_script(DRAWN), errors, [one["request"]["url"] for one in sent]


def check_page(browser, page, least_figures):
    """Hold what every page must be."""
    for width in (PHONE, SCREEN):
        figures, errors, asked = look_at(browser, page, width)
        assert not errors
        assert all(url == page.as_uri() or url.startswith(("data:", "blob:")) for url in asked)
        assert len(figures) >= least_figures
        for number, (wide, canvases, colours) in enumerate(figures):
            assert canvases and len(colours) > 5, f"figure {number} is empty"
            assert 250 < wide <= width
        sideways = browser.execute_script(
            "const e = document.documentElement; return e.scrollWidth - e.clientWidth"
        )
        assert sideways <= 0, "the page must be scrolled sideways"


SHORT = ("-p", "ground_motion:synthetic.duration:=3.0", "-p", "ground_motion:tail:=1.0")


def report_of(folder, config, *words):
    """Simulate a short test and write its report."""
    for call in (("simulate", config, *SHORT, *words, "--out", "bag"), ("report", "bag")):
        subprocess.run([sys.executable, "-m", "seft_ros.cli.main", *map(str, call)], cwd=folder)
    return folder / "bag" / "report.html"


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return report_of(tmp_path_factory.mktemp("demo"), DEMO)


def test_a_report_is_drawn_on_a_phone_and_on_a_screen(browser, demo):
    check_page(browser, demo, least_figures=18)
    assert "can be trusted" in browser.find_element("css selector", ".verdict").text


def test_figures_over_time_zoom_together(browser, demo):
    look_at(browser, demo, SCREEN)
    shared = browser.execute_script(
        "const counts = new Map();"
        "for (const model of Bokeh.documents.flatMap((d) => [...d._all_models.values()]))"
        " if (model.type === 'Figure')"
        "  counts.set(model.x_range.id, (counts.get(model.x_range.id) ?? 0) + 1);"
        "return Math.max(...counts.values());"
    )
    assert shared == 3


def test_a_finger_scrolls_and_does_not_zoom(browser, demo):
    browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    features = [{"name": "pointer", "value": "coarse"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    try:
        look_at(browser, demo, PHONE)
        released = browser.execute_script(
            "return Bokeh.documents.flatMap((d) => [...d._all_models.values()])"
            ".filter((m) => m.type === 'Toolbar').map((t) => t.active_drag === null)"
        )
    finally:
        browser.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": False})
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})
    assert released
    assert all(released)


def test_a_page_of_a_study_is_drawn(browser, tmp_path):
    command = ("study", JHU, *SHORT, "--tests", "30", "--spread", "0.2", "--mass-ratio", "0.5")
    command = (*command, "--method", "none", "--method", "restoring")
    subprocess.run([sys.executable, "-m", "seft_ros.cli.main", *map(str, command)], cwd=tmp_path)
    check_page(browser, tmp_path / "study.html", least_figures=1)
    assert "95 % of the tests" in browser.find_element("css selector", ".verdict").text
