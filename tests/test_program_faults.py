"""No fault of a node's program and no request of a stranger leaves a rig without its supervisor."""

import os
import signal

import pytest
from graph_tools import JHU, ROOT, STALLS_ALLOWED, thorough, wait_for
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import (
    DescribeParameters,
    GetParameters,
    GetParameterTypes,
    ListParameters,
    SetParameters,
    SetParametersAtomically,
)
from seft_msgs_py.node.rclpy_interface import message_class, qos_profile
from seft_msgs_py.wire.topics import DIAGNOSTICS
from seft_ros.test_run.processes import MODULES

OVERRIDES = (
    *STALLS_ALLOWED[1::2],
    "rig:pace:=lockstep",
    "reference_force:ramp_down_time:=0.1",
    "ground_motion:synthetic.duration:=1000.0",
)


@pytest.fixture
def told(observer):
    """Node -> the values of its last status, as they come in while the observer spins."""
    found = {name: {} for name in MODULES}

    def listen(message):
        for status in message.status:
            found[status.name] = {item.key: item.value for item in status.values}

    observer._node.create_subscription(
        message_class(DIAGNOSTICS), DIAGNOSTICS.name, listen, qos_profile(DIAGNOSTICS)
    )
    return found


def wait_while_spinning(observer, condition, what):
    wait_for(lambda: (observer.spin(0.02), condition())[1], what)


def begin_test(observer):
    wait_while_spinning(observer, lambda: observer.state == "ready", "ready")
    observer.time_ns = 0
    accepted, answer = observer.call("start")
    assert accepted, answer
    wait_while_spinning(observer, lambda: observer.time_ns > 3e8, "a part of the test")


def reset(observer):
    wait_for(lambda: observer.call("reset")[0], "the rig at rest")
    wait_while_spinning(observer, lambda: observer.state in ("idle", "ready"), "idle")


@pytest.mark.parametrize(
    "faulty",
    [
        ("rig", "supervisor"),
        thorough(("ground_motion", "reference_force", "force_controller", "recorder")),
    ],
)
def test_a_fault_in_a_node_ends_the_test_and_is_told_and_the_emergency_stop_goes_on_answering(
    start, observer, told, faulty
):
    paths = os.pathsep.join([str(ROOT / "tests"), os.environ.get("PYTHONPATH", "")])
    words = ["--ros-args", "--params-file", JHU]
    words += [part for override in OVERRIDES for part in ("-p", override)]
    nodes = {
        node: start("faulty_nodes", module, *words, env=os.environ | {"PYTHONPATH": paths})
        for node, module in MODULES.items()
    }
    for node in faulty:
        begin_test(observer)
        nodes[node].send_signal(signal.SIGUSR1)
        wait_while_spinning(observer, lambda: observer.state == "tripped", f"the trip by {node}")
        assert f"a fault of the program in {node}, " in observer.values["detail"]
        assert "KeyError: " in observer.values["detail"]
        wait_while_spinning(
            observer, lambda node=node: told[node].get("faults") == "1", f"the count of {node}"
        )
        assert observer.call("estop")[0]
        reset(observer)
    for node, process in nodes.items():
        process.send_signal(signal.SIGINT)
        _, log = process.communicate()
        assert process.returncode == 0
        assert log.count("Traceback") == (node in faulty), node


def requests():
    """Give requests to each service of parameters that make little sense, or none."""
    nan, deep = float("nan"), "a" + ".b" * 500
    names = [
        "",
        ".",
        " ",
        "\n",
        "use_sim_time",
        "rate",
        "no_such",
        deep,
        "x" * 100_000,
        "\u00e4/%s",
    ]
    values = [
        ParameterValue(type=kind, double_value=nan, double_array_value=[nan, float("inf")])
        for kind in (*range(10), 10, 99, 255)
    ]
    values += [
        ParameterValue(type=8, double_array_value=[nan] * 100_000),
        ParameterValue(type=9, string_array_value=["x"] * 10_000),
        ParameterValue(type=4, string_value="\x01\n" * 1000),
        ParameterValue(type=2, integer_value=-(2**63)),
    ]
    sets = [[Parameter(name=n, value=v)] for n in (*names[:7], "name") for v in values]
    sets.append([Parameter(name=f"p{i}", value=values[3]) for i in range(1000)])
    many = [names, [], *[[n] for n in names], ["rate"] * 1000]
    found = [(SetParameters, "set_parameters", {"parameters": p}) for p in sets]
    kind = SetParametersAtomically
    found += [(kind, "set_parameters_atomically", {"parameters": p}) for p in (*sets, [])]
    for kind, service in (
        (GetParameters, "get_parameters"),
        (GetParameterTypes, "get_parameter_types"),
        (DescribeParameters, "describe_parameters"),
    ):
        found += [(kind, service, {"names": each}) for each in many]
    depths = (0, 1, 2**64 - 1)
    found += [
        (ListParameters, "list_parameters", {"prefixes": p, "depth": d})
        for p in many
        for d in depths
    ]
    return found


def test_no_request_stops_a_node_or_the_test_that_runs(start_node, observer, told):
    nodes = {node: start_node(node, *OVERRIDES) for node in MODULES}
    begin_test(observer)
    clients = {}

    def ask(node, kind, service, fields):
        key = (kind, f"{node}/{service}")
        if key not in clients:
            clients[key] = observer._node.create_client(*key)
            wait_for(clients[key].service_is_ready, f"{service} of {node}")
        return clients[key].call_async(kind.Request(**fields))

    for number, request in enumerate(requests()):
        asked = [ask(node, *request) for node in MODULES]
        if number % 20 == 0:  # of what makes no sense there is no answer to wait for
            observer.spin(0.01)
        del asked
    for node in MODULES:
        answer = ask(node, GetParameters, "get_parameters", {"names": ["rate"]})
        wait_while_spinning(observer, answer.done, f"an answer of {node}")
        assert answer.result().values[0].double_value == 500.0
    assert observer.state == "running", observer.values
    wait_while_spinning(observer, lambda: all(told.values()), "a status of each node")
    assert {node: values["faults"] for node, values in told.items()} == dict.fromkeys(MODULES, "0")
    assert observer.call("start")[0] is False
    assert observer.call("reset")[0] is False
    assert observer.call("estop")[0]
    wait_while_spinning(observer, lambda: observer.state == "tripped", "the trip")
    assert all(process.poll() is None for process in nodes.values())
