"""`seft monitor` in a real browser, beside a real run."""

import json
import os
import signal
from urllib.parse import urlsplit

import pytest
from graph_tools import DEMO, MISSES_ALLOWED, STALLS_ALLOWED, shared_memory, wait_for
from real_browser import DRAWN, NEEDED, PHONE, SCREEN, start_browser, webdriver

pytestmark = [NEEDED, pytest.mark.thorough, pytest.mark.browser, pytest.mark.wallclock]
LONG = (
    *("-p", "ground_motion:synthetic.duration:=600.0"),
    # without feedback, many missed commands do not shake the rig
    *("-p", "actuator.kind:=ideal", "-p", "reference_force:compensation.method:=none"),
    *("-p", "force_controller:method:=transfer_function"),
    *("-p", "reference_force:method:=eft", "-p", "reference_force:mass_ratio:=0.0"),
    *("-p", "ground_motion:peak_force:=500.0"),
    *(*STALLS_ALLOWED, *MISSES_ALLOWED),
)
"""A test that is still running whenever a browser is ready, also on a machine with much to do."""
MEASURED, ERROR = 0x0B5FA5, 0x8F5500
POINTS = """
return Bokeh.documents.slice(0, 5).map((d) => {
  const found = {};
  for (const renderer of d.roots()[0].renderers)
    found[renderer.data_source.name] = renderer.data_source.data.y.filter(Number.isFinite).length;
  return found;
});
"""
"""Points of each line in the first figures."""

SHOW_ALL = """
const choice = document.getElementById("window");
choice.value = "0";
choice.dispatchEvent(new Event("change"));
"""
SPAN = """
const {x_range, renderers} = Bokeh.documents[0]?.roots()[0] ?? {};
return x_range && [x_range.start, x_range.end, renderers[0].data_source.data.x[0] ?? null];
"""
"""Of the first figure, in s: where its axis of time begins and ends, and where its line begins."""


@pytest.fixture
def browser(tmp_path):
    driver = start_browser(tmp_path / "browser")
    driver.set_window_size(SCREEN, 2000)
    yield driver
    driver.quit()


@pytest.fixture
def monitor(start):
    """Start a monitor; give the process and the address that it prints."""

    def launch(*words):
        process = start("seft_ros.cli.main", "monitor", "--port", "0", *words)
        line = process.stdout.readline()
        assert line.startswith("seft monitor: "), process.stderr.read()
        return process, line.split()[-1]

    return launch


@pytest.fixture
def run(start):
    """Start a test that lasts."""
    return lambda *words: start("seft_ros.cli.main", "run", DEMO, *LONG, *words)


def text(browser, name):
    return browser.find_element("id", name).text


def seconds(browser):
    shown = text(browser, "time").removesuffix(" s")
    return float(shown) if shown[:1].isdigit() else -1.0


def state(browser):
    return text(browser, "state-name")


def beginning(browser):
    """Give, in a tuple, where the first figure and its line begin while its end moves on."""
    start, end, _ = browser.execute_script(SPAN) or (None,) * 3
    wait_for(lambda: (browser.execute_script(SPAN) or [end, end])[1] != end, "the plots to move on")
    again, end, line = browser.execute_script(SPAN)
    close = line is not None and line - again <= 0.01 * (end - again)
    return (again,) if close and again == start else None


def lines_are_drawn(browser):
    """Tell of the figures of displacement, its error, force's, acceleration and force."""
    drawn = [colours for *_, colours in browser.execute_script(DRAWN)]
    wanted = (MEASURED, ERROR, ERROR, MEASURED, MEASURED)
    return [colour in found for colour, found in zip(wanted, drawn, strict=False)]


def press(browser, *keys):
    webdriver.ActionChains(browser).send_keys(*keys).perform()


def hold_clean(browser, address):
    """Hold that the page had no errors and asked nobody else."""
    errors = [e["message"] for e in browser.get_log("browser") if e["level"] != "INFO"]
    assert not errors
    asked = []
    for entry in browser.get_log("performance"):
        message = json.loads(entry["message"])["message"]
        if message["method"] == "Network.requestWillBeSent":
            asked.append(message["params"]["request"]["url"])
        elif message["method"] == "Network.webSocketCreated":
            asked.append(message["params"]["url"])
    assert any(url.startswith("ws:") for url in asked)
    asked = [url for url in asked if urlsplit(url).scheme in ("http", "https", "ws", "wss")]
    assert {urlsplit(url).netloc for url in asked} == {urlsplit(address).netloc}


def end(process, *, after=signal.SIGINT):
    """End a process as Ctrl-C does; nothing of it may be left in /dev/shm."""
    assert not shared_memory(process.pid)
    process.send_signal(after)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 0, out + err
    assert not err


def test_a_run_is_shown_survives_a_reload_and_is_stopped_at_once(browser, monitor, run):
    server, address = monitor()
    browser.get(address)
    wait_for(lambda: state(browser) == "no test", "the page to be connected")
    test = run()
    wait_for(lambda: seconds(browser) > 1.0 or test.poll() is not None, "the plots to move")
    assert test.poll() is None, test.stderr.read() + text(browser, "events")
    wait_for(lambda: state(browser) == "running", "the state of the test")
    before = seconds(browser)
    wait_for(lambda: seconds(browser) > before, "the plots to move on")
    assert state(browser) == "running"
    wait_for(lambda: all(lines_are_drawn(browser)), "the lines")
    wait_for(lambda: "left" in text(browser, "margin"), "margins")
    wait_for(lambda: all(min(n.values()) > 10 for n in browser.execute_script(POINTS)), "points")
    browser.execute_script(SHOW_ALL)
    begin = wait_for(lambda: beginning(browser), "the test from its first step on")
    assert begin[0] < before
    browser.refresh()
    wait_for(lambda: seconds(browser) > before, "the page after its reload")
    browser.execute_script(SHOW_ALL)
    assert wait_for(lambda: beginning(browser), "the whole test after the reload") == begin
    browser.find_element("id", "estop").click()
    wait_for(lambda: state(browser) == "tripped", "the end of the test")
    assert "aborted by the operator" in text(browser, "state-detail")
    assert test.wait(60) == 1
    assert "aborted by the operator" in test.stderr.read()
    wait_for(
        lambda: "have shut down" in text(browser, "state-detail"), "the nodes' end to be shown"
    )
    os.kill(server.pid, signal.SIGSTOP)
    wait_for(lambda: state(browser) == "no data", "the page to miss the monitor")
    assert browser.find_element("tag name", "body").get_attribute("data-stale") == "true"
    os.kill(server.pid, signal.SIGCONT)
    wait_for(lambda: state(browser) == "tripped", "the monitor to be back")
    assert "aborted by the operator" in text(browser, "events")
    hold_clean(browser, address)
    end(server)


def test_keys_stop_a_test_that_began_before_the_monitor_beyond_localhost(browser, monitor, run):
    test = run("-p", "ground_motion:tail:=600.0")
    server, address = monitor("--host", "0.0.0.0", "--token", "for-this-test")
    bare = address.split("?")[0]
    browser.get(bare)
    assert "token" in browser.find_element("tag name", "body").text
    assert "running" not in browser.page_source
    browser.get_log("browser")  # of the refusal
    browser.find_element("id", "token").send_keys("for-this-test\n")
    wait_for(lambda: browser.find_elements("id", "estop"), "the page")
    assert browser.current_url == bare
    browser.set_window_size(PHONE, 900)
    wait_for(lambda: seconds(browser) > 1.0, "the running test")
    sideways = browser.execute_script(
        "const e = document.documentElement; return e.scrollWidth - e.clientWidth"
    )
    assert sideways <= 0, "the page must be scrolled sideways"
    keys = webdriver.Keys
    order = []
    for _ in range(2):  # a test that runs can't be started
        press(browser, keys.TAB)
        order.append(browser.switch_to.active_element.get_attribute("id"))
    assert order == ["estop", "stop"]
    press(browser, keys.ENTER)
    assert browser.switch_to.active_element.text == "Stop"
    assert state(browser) in ("running", "no data")  # which it says while the host stalls
    press(browser, keys.ENTER)
    wait_for(lambda: state(browser) == "done", "the end of the test")
    assert "stopped by the operator" in text(browser, "state-detail")
    wait_for(lambda: "ramping down" in text(browser, "answer"), "the answer")
    assert "stopped by the operator at " in test.communicate(timeout=60)[0].lower()
    assert test.returncode == 0
    hold_clean(browser, bare)
    end(server, after=signal.SIGTERM)
