"""What the benchmarks of whole runs share."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.node.process import prepare_on_this_host
from seft_msgs_py.wire.messages import Status, decode_diagnostics
from seft_ros.bags.recording import Recording
from seft_ros.bags.recording_bag import read_bag
from seft_ros.test_run.parameter_tables import TABLES
from seft_ros.test_run.processes import ProcessLayout
from seft_ros.test_run.run import run_experiment

CONFIG = Path(__file__).parent.parent / "config" / "jhu.yaml"


def use_own_domain() -> None:
    """Keep apart from other tests on this machine."""
    prepare_on_this_host()
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)


@contextmanager
def recorded_run(
    *overrides: tuple[str, str, Any], layout: ProcessLayout | None = None
) -> Iterator[tuple[Recording, dict[str, Status]]]:
    """Run jhu.yaml over DDS; give the recording and the last status of each node."""
    measured = ("supervisor", "watchdog.missed_share", 1.0)  # which is no reason to end
    experiment = Experiment.load(TABLES, [CONFIG], [measured, *overrides])
    with tempfile.TemporaryDirectory() as folder:
        bag = Path(folder) / "bag"
        fault, bag = run_experiment(experiment, bag, lambda *_: None, layout=layout)
        if fault:
            raise RuntimeError(fault)
        statuses = {}
        with AnyReader([bag]) as reader:
            diagnostics = [c for c in reader.connections if c.topic == "/diagnostics"]
            for _, _, raw in reader.messages(diagnostics):
                statuses.update({s.name: s for s in decode_diagnostics(raw)[1]})
        yield read_bag(bag), statuses
