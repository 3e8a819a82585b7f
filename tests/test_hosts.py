"""A test on two hosts: the computed structure on a, the rig with its force controller on b."""

import json
import threading
import time

import pytest
from graph_tools import DEMO, MISSES_ALLOWED, PATIENCE, STALLS_ALLOWED, children, wait_for
from seft_msgs_py.config.facts import CHANNELS
from two_hosts import promptly, two_hosts

__all__ = ["two_hosts"]

pytestmark = [pytest.mark.thorough, pytest.mark.hosts, pytest.mark.wallclock]

LOOP_DELAY = 9
DELAYED = {"delay": 0.005, "jitter": 0.001}
PLAN = (*("-p", "reference_force:mass_ratio:=1.0"), *("-p", f"loop_delay:={LOOP_DELAY}"))
NO_LIMITS = (
    *(f"limits.{name}:=1e9" for name in CHANNELS),
    *(f"limits.{name}_rate:=1e12" for name in CHANNELS),
    "limits.saturated_time:=1e3",
    "force_controller:watchdog.saturation_time:=1e3",
)
PATIENT = (  # whatever a machine that stands still makes of a test, it goes on to its end
    *STALLS_ALLOWED,
    *MISSES_ALLOWED,
    *("-p", "rig:watchdog.supervisor_timeout:=60.0"),
    *(word for limit in NO_LIMITS for word in ("-p", limit)),
)
SILENCE = (  # what a machine that stands still may take, without it being a cut
    *("-p", "force_controller:watchdog.reference_timeout:=1.0"),
    *("-p", "rig:watchdog.supervisor_timeout:=5.0"),
    *("-p", "supervisor:watchdog.peer_timeout:=10.0"),
    *("-p", "supervisor:watchdog.missed_share:=1.0"),
    *("-p", "rig:watchdog.command_timeout:=5.0"),
    *MISSES_ALLOWED,
)
ELSEWHERE = ("--external", "rig", "--external", "force_controller")


@pytest.fixture
def rig_host(two_hosts):
    """Start rig and force controller on b; gives the processes."""

    def start(*words):
        arguments = ("--ros-args", "--params-file", DEMO, *PLAN, *words)
        return [
            two_hosts.start("b", module, *arguments, prompt=True)
            for module in ("seft_plant_sim.rig_node", "seft_ros.nodes.force_controller_node")
        ]

    return start


def seft_run(two_hosts, *words):
    """Start `seft run` on a; what it starts is to run promptly."""
    run = two_hosts.start("a", "seft_ros.cli.main", "run", DEMO, *ELSEWHERE, *PLAN, *words)

    def hurry():
        while run.poll() is None:
            for pid in children(run.pid).values():
                promptly(pid)
            time.sleep(0.2)

    threading.Thread(target=hurry, daemon=True).start()
    return run


def run_over(two_hosts, rig_host, **link):
    """Run a test over the link."""
    two_hosts.link(**link)
    rig_host(*PATIENT)
    run = seft_run(two_hosts, *PATIENT, "--out", "hosts", "--json")
    out, errors = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, errors
    over = json.loads(out)
    assert over["trip"] is None
    assert over["steps"] == 7001
    return over


def assert_accurate(over, most, unanswered=0):
    """Hold the displacement to a bound, unless this machine itself stood still too often.

    A state that does not come over the link, or after a newer one, has no answer of its own: so
    many may lack.
    """
    if over["missed"] < 0.02 * over["steps"]:
        others = {k: count for k, count in over["lost"].items() if k != "reference_force"}
        assert others == dict.fromkeys(others, 0)
        assert over["lost"]["reference_force"] <= unanswered
        assert over["displacement"]["nrmse"] < most


def test_a_link_with_delay_and_jitter_costs_little(two_hosts, rig_host, seft_json):
    over = run_over(two_hosts, rig_host, **DELAYED)
    assert_accurate(over, 0.03)
    assert over["link"]["loop_delay"] == LOOP_DELAY
    assert over["link"]["age"]["p50"] >= 5  # 10 ms: it went over the link
    assert over["link"]["forces"] == over["steps"]
    simulated = seft_json("simulate", DEMO, *PLAN, "--out", "simulated")
    compared = seft_json("compare", "simulated", "hosts", status=None)
    if not (over["missed"] or over["overruns"] or over["link"]["late"]):
        assert compared["identical"] is True
    assert simulated["steps"] == over["steps"]


def test_what_is_lost_on_the_link_is_bridged(two_hosts, rig_host):
    """What comes twice or too late is refused: test_command.py, and its like of forces."""
    five_messages = 0.0101  # s
    loss = {"loss": 0.02, "burst": five_messages, "burst_period": 0.7}
    over = run_over(two_hosts, rig_host, **DELAYED, **loss)
    ways = two_hosts.link()
    assert_accurate(over, 0.05, unanswered=ways[1]["lost"])
    assert min(way["lost"] for way in ways) > 100


def test_a_cut_link_ends_the_test_and_both_hosts_say_why(two_hosts, rig_host):
    """The force comes down before: test_local_faults.py."""
    two_hosts.link(**DELAYED)
    on_b = rig_host(*SILENCE)
    run = seft_run(two_hosts, *SILENCE, "--out", "hosts", "--json")
    bag = two_hosts.folder / "hosts" / "hosts.mcap"
    wait_for(lambda: bag.exists() and bag.stat().st_size > 300_000, "the test to be under way")
    two_hosts.link(cut=True)
    _, errors = run.communicate(timeout=PATIENCE)
    assert run.returncode == 1
    assert "has been silent since" in errors.splitlines()[-1]
    reasons = ("supervisor has been silent", "(the last is of step")
    for process, why in zip(on_b, reasons, strict=True):
        process.terminate()
        assert why in process.communicate(timeout=PATIENCE)[1]


def test_the_link_is_measured_and_a_test_takes_the_delay_that_it_needs(two_hosts, rig_host):
    two_hosts.link(**DELAYED)
    _, controller = rig_host(*PATIENT, "-p", "loop_delay:=-1")
    link = two_hosts.start(
        *("a", "seft_ros.cli.main", "link", DEMO, *PLAN[:2], "--duration", "4"),
        *("--out", "link.yaml", "--json"),
        prompt=True,
    )
    out, errors = link.communicate(timeout=PATIENCE)
    assert link.returncode == 0, errors
    found = json.loads(out)
    assert 0.008 < found["round_trip_s"]["p50"] < found["round_trip_s"]["p99"]
    assert found["loop_delay"] >= 6
    assert found["sent"] == 2000
    assert found["rate_within_a_step_hz"] < 125
    assert found["test"]["stable"] is True
    assert "loop_delay: " in (two_hosts.folder / "link.yaml").read_text()
    run = seft_run(
        two_hosts,
        *PATIENT,
        *("-p", "loop_delay:=-1", "--out", "hosts", "--json"),
        *("-p", "ground_motion:synthetic.duration:=6.0"),
    )
    out, errors = run.communicate(timeout=PATIENCE)
    assert run.returncode == 0, errors
    over = json.loads(out)
    assert f"a delay of the loop of {over['link']['loop_delay']} steps" in errors
    assert over["link"]["loop_delay"] >= 6
    assert controller.poll() is None


def test_a_link_is_measured_against_an_echo_too(two_hosts):
    two_hosts.link(delay=0.002, loss=0.03)
    echo = two_hosts.start("b", "seft_ros.cli.main", "link", "--echo", prompt=True)
    words = ("a", "seft_ros.cli.main", "link", "--duration", "4", "--json")
    link = two_hosts.start(*words, prompt=True)
    out, errors = link.communicate(timeout=PATIENCE)
    assert link.returncode == 0, errors
    found = json.loads(out)
    assert found["verdict"] == "marginal"
    assert 0.03 < found["lost"] / found["sent"] < 0.2
    assert found["test"] is None
    assert echo.poll() is None
    two_hosts.link(cut=True)
    link = two_hosts.start(*words)
    out, errors = link.communicate(timeout=PATIENCE)
    assert link.returncode == 2
    assert "nobody echoes" in errors
