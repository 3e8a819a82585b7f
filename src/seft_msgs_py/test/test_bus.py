"""Messages between nodes of one process: in order, to all, also those sent meanwhile."""

import pytest
from seft_msgs_py.node.turns import IntraProcessBus
from seft_msgs_py.wire.topics import DIAGNOSTICS, RIG_STATE, VALVE_COMMAND


def listener(heard, name, then=None):
    def receive(raw, received_ns, gid):
        assert received_ns > 0
        assert gid == b""
        heard.append((name, raw))
        if then is not None:
            then(raw)
        return True

    return receive


def test_a_message_goes_to_all_listeners_and_outside():
    box, heard, outside = IntraProcessBus(["rig"]), [], []
    for node in ("one", "two"):
        box.subscribe("/rig/state", node, listener(heard, node))
    box.sender("/rig/state", outside.append)(b"a")
    assert heard == []
    assert box.deliver() is True
    assert heard == [("one", b"a"), ("two", b"a")]
    assert outside == [b"a"]
    assert box.deliver() is False
    assert box.listeners("/rig/state") == ["one", "two"]


def test_outside_messages_go_when_those_inside_have_been_answered_and_in_order():
    box, seen = IntraProcessBus(["rig", "controller"]), []
    answer = box.sender("/valve_command", lambda raw: seen.append(("outside", raw)))
    box.subscribe("/rig/state", "controller", listener(seen, "controller", lambda _: answer(b"b")))
    box.subscribe("/valve_command", "rig", listener(seen, "rig"))
    box.sender("/rig/state", lambda raw: seen.append(("outside", raw)))(b"a")
    box.deliver()
    assert seen == [("controller", b"a"), ("rig", b"b"), ("outside", b"a"), ("outside", b"b")]


def test_what_waits_goes_outside_also_where_a_listener_fails_or_the_process_ends():
    box, outside = IntraProcessBus(["rig"]), []

    def fail(raw, received_ns, number):
        raise RuntimeError

    box.subscribe("/rig/state", "one", fail)
    publish = box.sender("/rig/state", outside.append)
    publish(b"a")
    with pytest.raises(RuntimeError):
        box.deliver()
    publish(b"b")
    box.send_outside()
    assert outside == [b"a", b"b"]


def test_a_mailbox_serves_topics_of_the_loop_that_its_own_nodes_publish():
    box = IntraProcessBus(["rig", "reference_force"])
    assert box.serves(RIG_STATE)
    assert not box.serves(VALVE_COMMAND)
    assert not box.serves(DIAGNOSTICS)
