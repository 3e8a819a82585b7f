import pytest
from seft_msgs_py.wire.messages import Status
from seft_msgs_py.wire.topics import NODES, TOPICS, rigs_of, topics_of, with_rigs
from seft_ros.test_run.peers import LastStatus, Rehearsed, check_peers, silence, silent, with_biases
from seft_ros.test_run.peers import missing as missing_after

PEERS = tuple(node for node in NODES if node != "supervisor")
NOW = 100.0
TIMEOUT = 3.0  # s
ONE_RIG = rigs_of(["x"])
TWO_RIGS = rigs_of(["west/x", "east/x"])
PEERS_OF_TWO = with_rigs(PEERS, TWO_RIGS)


def missing(peers, statuses, descriptions, now, rigs=ONE_RIG):
    return missing_after(peers, statuses, descriptions, now, TIMEOUT, rigs)


def graph(peers=PEERS, drive="valve_command", rigs=ONE_RIG):
    """What a complete graph has said: status and description of each node."""
    everyone = " ".join(with_rigs(NODES, rigs))
    statuses, descriptions = {}, {}
    for node in (*peers, "supervisor"):
        own = [topic for topic in topics_of(rigs) if topic.publisher in (node, "")]
        values = {f"matched {topic.name}": everyone for topic in own}
        if node == "ground_motion":
            values["phase"] = "primed"
        statuses[node] = LastStatus(Status(node, 0, "", values=values), NOW - 0.5)
        descriptions[node] = {"parameters": {"rate": 500.0, "axes": ["x"]}}
    descriptions["rig"] = {**descriptions.get("rig", {}), "drive": drive}
    return statuses, descriptions


def test_of_several_rigs_each_must_be_there_and_hear():
    def lacks(change, rigs=TWO_RIGS):
        statuses, descriptions = graph(PEERS_OF_TWO, rigs=rigs)
        change(statuses, descriptions)
        return missing(PEERS_OF_TWO, statuses, descriptions, NOW, rigs)

    def deaf(statuses, _):
        values = statuses["west/rig"].status.values
        values["matched west/rig/state"] = "reference_force recorder"

    def driven(statuses, descriptions):
        descriptions["east/rig"]["drive"] = "reference_force"
        values = statuses["reference_force"].status.values
        values["matched reference_force"] = "west/force_controller east/force_controller recorder"

    assert lacks(lambda statuses, _: None) == ""
    assert lacks(lambda statuses, _: statuses.pop("east/rig")) == "node east/rig"
    assert lacks(deaf) == "west/rig to reach west/force_controller on west/rig/state"
    assert lacks(driven) == "reference_force to reach east/rig on reference_force"


def lost(publisher, topic, listener, **others):
    """What is missing where a listener does not hear a publisher on a topic."""
    statuses, descriptions = graph(**others)
    values = statuses[publisher].status.values
    values[f"matched {topic}"] = values[f"matched {topic}"].replace(listener, "")
    return missing(PEERS, statuses, descriptions, NOW)


@pytest.mark.parametrize("node", PEERS)
def test_a_node_that_was_never_heard_or_has_no_description_is_named(node):
    for place, named in enumerate((f"node {node}", f"the parameters of {node}")):
        said = graph()
        del said[place][node]
        assert missing(PEERS, *said, NOW) == named


@pytest.mark.parametrize(("age", "expected"), [(TIMEOUT, ""), (TIMEOUT + 0.01, "node rig")])
def test_a_node_that_fell_silent_counts_as_absent(age, expected):
    statuses, descriptions = graph()
    statuses["rig"] = LastStatus(statuses["rig"].status, NOW - age)
    assert missing(PEERS, statuses, descriptions, NOW) == expected


def facts(name, known, other, node="rig"):
    return {"reference_force": {name: known}, node: {} if other is None else {name: other}}


def delays(sent, taken):
    return facts("loop_delay", sent, taken, "force_controller")


FITTING = [(0, 0), (7, 7), (7, -1)]  # -1: it is the other's
UNLIKE = [(7, 0), (0, 7), (0, -1)]
PACES = {"west/rig": {"pace": "realtime"}, "east/rig": {"pace": "lockstep"}}
PARAMETERS = [
    (ONE_RIG, {"rig": {"rate": 1000.0}}, "one rate: ground_motion has 500.0, rig has 1000.0"),
    (ONE_RIG, {"rig": {"axes": ["y"]}}, "one axes: ground_motion has ['x'], rig has ['y']"),
    (TWO_RIGS, PACES, "one pace: west/rig has realtime, east/rig has lockstep"),
    (TWO_RIGS, facts("loop_delay", 0, 3, "east/force_controller"), "one loop_delay: reference_fo"),
    (ONE_RIG, facts("calibration.force_lag", 0.0, 0.003), "one calibration.force_lag: "),
    (ONE_RIG, facts("specimen.mass", [50.0], None), ""),  # a rig that does not tell it
    (ONE_RIG, facts("mass_ratio", 1.0, 0.5, "force_controller"), "one mass_ratio: reference_force"),
    *((ONE_RIG, delays(*both), "") for both in FITTING),
    *((ONE_RIG, delays(*both), "one loop_delay: reference_force has") for both in UNLIKE),
]


@pytest.mark.parametrize(("rigs", "known", "expected"), PARAMETERS)
def test_nodes_that_were_started_differently_are_named_with_their_values(rigs, known, expected):
    peers = with_rigs(PEERS, rigs)
    statuses, descriptions = graph(peers, rigs=rigs)
    for node, values in known.items():
        parameters = {**descriptions[node]["parameters"], **values}
        descriptions[node] = {**descriptions[node], "parameters": parameters}
    found = missing(peers, statuses, descriptions, NOW, rigs)
    assert found.startswith(expected) if expected else found == ""


LINKS = [
    ("ground_motion", "ground_motion", "reference_force"),
    ("rig", "rig/state", "reference_force"),
    ("rig", "rig/state", "force_controller"),
    ("reference_force", "reference_force", "force_controller"),
    ("force_controller", "valve_command", "rig"),
    ("supervisor", "experiment/state", "rig"),
    ("supervisor", "experiment/state", "ground_motion"),
    ("rig", "diagnostics", "supervisor"),
    ("reference_force", "diagnostics", "supervisor"),
]


@pytest.mark.parametrize(("publisher", "topic", "listener"), LINKS)
def test_a_link_of_the_loop_that_is_not_there_is_named(publisher, topic, listener):
    assert lost(publisher, topic, listener) == f"{publisher} to reach {listener} on {topic}"


@pytest.mark.parametrize("topic", [topic for topic in TOPICS if topic.recorded and topic.publisher])
def test_the_recorder_must_hear_every_recorded_topic(topic):
    expected = f"{topic.publisher} to reach recorder on {topic.name}"
    assert lost(topic.publisher, topic.name, "recorder") == expected


def test_without_a_recorder_nobody_waits_for_it():
    peers = tuple(node for node in PEERS if node != "recorder")
    statuses, descriptions = graph(peers)
    for node in statuses.values():
        for key, value in node.status.values.items():
            node.status.values[key] = value.replace("recorder", "")
    assert missing(peers, statuses, descriptions, NOW) == ""


LAST_TEST = "to leave the last test"


@pytest.mark.parametrize(
    ("node", "values", "expected"),
    [
        ("ground_motion", {"phase": "idle"}, "the first of the ground motion"),
        ("force_controller", {"senders rig/state": "1"}, ""),
        (  # a listener that knows no sender yet
            *("force_controller", {"senders rig/state": "0"}),
            "force_controller to receive from rig on rig/state",
        ),
        ("rig", {"phase": "idle"}, ""),
        *(
            ("rig", {"phase": p}, f"the rig {LAST_TEST}")
            for p in ("running", "finished", "tripped")
        ),
        *(
            ("reference_force", {"phase": phase}, f"the reference force {LAST_TEST}")
            for phase in ("ramping_down", "at_rest", "ended")
        ),
        ("recorder", {"phase": "recording"}, "the recorder to save the last test"),
        ("recorder", {"phase": "saved", "waits": "it is full"}, "the recorder, as it is full"),
        ("recorder", {"phase": "saved", "waits": ""}, ""),
    ],
)
def test_a_node_that_is_not_ready_for_the_next_test_is_waited_for(node, values, expected):
    statuses, descriptions = graph()
    statuses[node].status.values.update(values)
    assert missing(PEERS, statuses, descriptions, NOW) == expected


def test_a_test_without_a_ground_motion_node_waits_for_it_too():
    peers = tuple(node for node in PEERS if node != "ground_motion")
    statuses, descriptions = graph(peers)
    assert missing(peers, statuses, descriptions, NOW) == "the first of the ground motion"


def test_the_silent_are_named_with_the_time_of_their_last_sign_of_life():
    statuses, _ = graph()
    statuses["rig"] = LastStatus(statuses["rig"].status, NOW - 1.01, 12.341)
    statuses["recorder"] = LastStatus(statuses["recorder"].status, NOW - 1.0, 12.4)
    del statuses["ground_motion"]  # never heard: not silent, but absent
    assert silent(PEERS, statuses, NOW, 1.0) == ["rig"]
    assert silence("rig", statuses) == "node rig has been silent since 12.34 s"


ABLE = {"rehearses": True}


def loop(rig=ABLE):
    return {"rig": rig, "reference_force": ABLE, "force_controller": ABLE, "ground_motion": {}}


def rig(missed=0, p99=0.0005, rate=1000.0, steps=1500):
    found = {"rate_hz": rate, "steps": steps, "missed": missed, "overruns": 0}
    return loop(ABLE | {"rehearsal": {**found, "round_trip_alone_s": {"p99": p99} if p99 else {}}})


def test_a_rig_that_can_is_asked_until_it_has_answered():
    assert check_peers(2.0, loop()) == Rehearsed(asked=2.0)
    assert check_peers(2.0, rig()) == Rehearsed()


LIMITS = {"displacement": 0.03, "velocity": 0.5, "acceleration": 50.0, "force": 4500.0}


def zeroed(left=0.0, **subtracted):
    """Description of a rig that has measured at rest."""
    rows = {name: [subtracted.get(name, 0.0), 0.0] for name in LIMITS}
    lefts = {name: [0.0, left * (name == "force")] for name in LIMITS}
    return {
        "parameters": {f"limits.{name}": limit for name, limit in LIMITS.items()},
        "zeroed": {"samples": 500, "subtracted": rows, "left": lefts},
    }


def test_a_bias_of_more_than_a_tenth_of_a_limit_is_refused():
    assert with_biases(Rehearsed(), [zeroed(force=4.0), {}]) == Rehearsed()
    message = with_biases(Rehearsed(), [zeroed(), zeroed(displacement=-0.004)]).refusal
    assert message.startswith(
        "displacement is 0.004 m at rest, more than a tenth of its limit of 0.03"
    )
    assert with_biases(Rehearsed(asked=2.0), [zeroed(force=900.0)]) == Rehearsed(asked=2.0)
    assert "can't be read" in with_biases(Rehearsed(), [zeroed() | {"zeroed": 3}]).refusal


def test_a_force_at_rest_that_may_be_real_is_warned_of():
    found = with_biases(Rehearsed(warning="slow"), [zeroed(force=21.0)])
    assert found.warning.startswith("slow; a force of 21 N at rest was zeroed: if friction or a")
    assert not found.refusal
    held = with_biases(Rehearsed(), [zeroed(left=-21.0)]).warning
    assert held.startswith("the force at rest is 21 N beside its known bias: friction or")


def test_nobody_is_asked_where_there_is_no_rehearsal():
    assert check_peers(0.0, loop()) == Rehearsed()
    graphs = [{"west/rig": ABLE, "east/rig": ABLE, "reference_force": ABLE}]
    for node in ("rig", "reference_force", "force_controller"):
        unable, absent = loop() | {node: {"drive": "valve_command"}}, loop()
        del absent[node]
        graphs += unable, absent
    assert [check_peers(2.0, each) for each in graphs] == [Rehearsed()] * 7


def test_a_loop_that_does_not_keep_its_rate_is_refused_with_one_that_fits():
    message = check_peers(2.0, rig(missed=900, p99=0.0016)).refusal
    assert message.startswith(
        "1000 Hz does not fit here: round trip p99 1.6 ms, 900 of 1500 steps without a command in "
        "time; 500 Hz does; "
    )
    assert "--composed" in message


def test_where_no_rate_fits_none_is_proposed():
    assert "Hz does;" not in check_peers(2.0, rig(missed=1500, p99=0.5)).refusal


def test_a_loop_that_does_not_answer_is_refused():
    assert "no answer came" in check_peers(2.0, rig(missed=1500, p99=None)).refusal


@pytest.mark.parametrize("missed", [2, 100, 149])
def test_a_few_missed_steps_are_warned_of(missed):
    found = check_peers(2.0, rig(missed=missed, p99=0.0009))
    assert not found.refusal and not found.asked
    assert found.warning.startswith("1000 Hz is hard to keep here: round trip p99 0.9 ms")
    assert f"{missed} of 1500" in found.warning


@pytest.mark.parametrize(
    "answer", [{}, 3, {"steps": "x"}, {"steps": 1, "missed": 0, "rate_hz": 1.0}]
)
def test_a_rehearsal_that_makes_no_sense_is_refused(answer):
    assert "can't be read" in check_peers(2.0, loop(ABLE | {"rehearsal": answer})).refusal
