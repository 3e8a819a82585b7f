"""How nodes start, in virtual time: their help, their defaults, what they refuse."""

import pytest
from graph_tools import BRIDGE
from local_tools import UNREHEARSED
from seft_ros.nodes.loop_node import NODE_KINDS


@pytest.mark.parametrize("node", NODE_KINDS)
def test_a_node_explains_itself_within_80_columns(node):
    words = NODE_KINDS[node].help()
    assert f"{node} --ros-args --params-file config/demo.yaml" in words
    assert "ros2 run seft_" in words and "\n  rate: 500.0 Hz\n" in words
    assert max(map(len, words.splitlines())) <= 80


@pytest.mark.parametrize("node", NODE_KINDS)
def test_a_node_tells_a_wrong_parameter_in_one_line(local_graph, capsys, node):
    graph = local_graph(UNREHEARSED, nodes=())
    graph.start(node, overrides=[f"{node}:noise:=1"])
    graph.until(lambda: graph.endings)
    assert graph.endings == {node: 2}
    (line,) = capsys.readouterr().err.splitlines()
    assert f"{node}: -p: {node}: there is no parameter noise" in line


def test_nodes_that_are_reported_of_a_specimen_need_no_file(local_graph):
    nodes = ("recorder", "supervisor", "force_controller", "ground_motion")
    specimen = ("specimen.mass:=52.7", "specimen.stiffness:=2.11e5")
    graph = local_graph(*specimen, nodes=nodes, own_files={node: [] for node in nodes})
    graph.until(lambda: all(graph.status(node) for node in nodes if node != "supervisor"))
    assert graph.endings == {}


@pytest.mark.parametrize(
    ("node", "message"),
    [
        ("rig", "name its rig: --ros-args -r __ns:=/west or -r __ns:=/east"),
        ("lab/rig", "in namespace /lab, but the axes"),
        ("east/supervisor", "supervisor serves all rigs and can't be in /east"),
    ],
)
def test_a_node_must_say_which_rig_s_it_is(local_graph, capsys, node, message):
    graph = local_graph(config=BRIDGE, nodes=())
    graph.start(node)
    graph.until(lambda: graph.endings)
    assert graph.endings == {node: 2}
    assert message in capsys.readouterr().err
