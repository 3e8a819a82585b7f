"""The nodes of a test, ready for its start.

    ros2 launch seft_ros experiment.launch.py config:=config/demo.yaml pace:=lockstep
    ros2 service call /start std_srvs/srv/Trigger

All nodes end when one ends, and at Ctrl-C, which ends a running test at once. To ramp the test
down, call /stop first.
"""

import contextlib

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessStart
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare
from seft_msgs_py.config.experiment import Experiment, value_text
from seft_msgs_py.wire.topics import LOOP_NODES, bare, rig_name, with_rigs
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.processes import MODULES, ProcessLayout

BAG = "name of the bag; empty: the experiment's, or date and time of the start"
RIG = "hardware: a laboratory's driver runs already, or is started beside this"
DEMO = PathJoinSubstitution([FindPackageShare("seft_ros"), "config", "demo.yaml"])
YES_OR_NO = ["true", "false"]
PACES = ["", "realtime", "lockstep"]
ARGUMENTS = [
    DeclareLaunchArgument(name, default_value=default, choices=choices, description=text)
    for name, default, choices, text in (
        ("config", DEMO, None, "parameter file of the experiment"),
        ("record", "true", YES_OR_NO, "record a bag"),
        ("bag", "", None, BAG),
        ("pace", "", PACES, "pace of the simulated rig; empty: the experiment's"),
        ("composed", "false", YES_OR_NO, "put the loop's nodes into one process"),
        ("pin", "true", YES_OR_NO, "keep the loop's nodes on one core and the others off it"),
        ("rig", "simulated", ["simulated", "hardware"], RIG),
    )
]


def nodes(context):
    """Read the experiment as every node will, and start its nodes."""
    said = {argument.name: LaunchConfiguration(argument.name) for argument in ARGUMENTS}
    said = {name: value.perform(context) for name, value in said.items()}
    overrides = []
    if said["pace"]:
        overrides.append(("rig", "pace", said["pace"]))
    if said["bag"]:
        overrides.append(("recorder", "name", said["bag"]))
    experiment = Experiment.load(TABLES, [said["config"]], overrides)
    peers = experiment["supervisor"]["peers"]
    if said["record"] == "false" and "recorder" in peers:
        peers = [node for node in peers if node != "recorder"]
        overrides.append(("supervisor", "peers", peers))
    wanted = [node for node in MODULES if node in (*peers, "supervisor")]
    if said["rig"] == "hardware":
        wanted.remove("rig")
    wanted = with_rigs(wanted, experiment.rigs)
    lockstep = experiment["rig"]["pace"] == "lockstep"
    layout = ProcessLayout(pin=said["pin"] == "true", composed=said["composed"] == "true")
    placement = layout.placement(wanted, lockstep=lockstep)
    for node in LOOP_NODES:
        overrides += [
            (node, name, value) for name, value in layout.realtime_parameters(node).items()
        ]
        if placement is not None and len(placement.loop) == 1:
            overrides.append((node, "cpu_core", min(placement.loop)))
    actions = []
    for group in layout.groups(wanted):
        process = _process(group, said["config"], overrides)
        if placement is not None:
            actions.append(_put(placement, group[0], process))
        actions.append(process)
    return actions


def _put(placement, node, process):
    """Put a process on its core when it has been started."""

    def put(event, _):
        with contextlib.suppress(OSError):  # it has ended; launch reports that
            placement.put(node, event.pid)

    return RegisterEventHandler(OnProcessStart(target_action=process, on_start=put))


def _process(group, config, overrides):
    alone, names = len(group) == 1, [bare(node) for node in group]
    own = [f"{node}:{name}:={value_text(v)}" for node, name, v in overrides if node in names]
    return Node(
        package="seft_plant_sim" if names == ["rig"] else "seft_ros",
        executable=names[0] if alone else "loop",
        namespace=rig_name(group[0]) or None,
        arguments=[] if alone else ["--nodes", *names],
        parameters=[config],
        ros_arguments=[word for override in own for word in ("-p", override)],
        output="screen",
        emulate_tty=True,
        on_exit=Shutdown(reason=f"{', '.join(group)} has ended"),
    )


def generate_launch_description():
    """Describe arguments and nodes."""
    return LaunchDescription([*ARGUMENTS, OpaqueFunction(function=nodes)])
