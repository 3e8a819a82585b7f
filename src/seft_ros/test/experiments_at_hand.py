"""Experiments of the project's folder, and what the offline loop makes of them."""

from pathlib import Path

from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

CONFIG = Path(__file__).parents[3] / "config"  # wherever it runs, as by colcon test
JHU = CONFIG / "jhu.yaml"


def load(*words, config="jhu", files=(), nodes=None):
    """Experiment of a file in config and of others; overrides as after -p, or in their parts."""
    overrides = [parse_override(word) if isinstance(word, str) else word for word in words]
    return Experiment.load(TABLES, [CONFIG / f"{config}.yaml", *files], overrides, nodes)


def of_parts(base, *parts, more=(), config=None):
    """Experiment of parameters by node, the later parts over the earlier ones, and overrides."""
    sections = {node: dict(values) for node, values in base.items()}
    for part in parts:
        for node, values in part.items():
            sections[node] = sections.get(node, {}) | values
    words = [(node, *item) for node, values in sections.items() for item in values.items()]
    files = [CONFIG / f"{config}.yaml"] if config else []
    return Experiment.load(TABLES, files, [*words, *more])


def simulated(experiment):
    """Record of a test by the offline loop."""
    return simulate_test(experiment, build_blocks(experiment))


def error_of(recording):
    """NRMSE of a recording's displacement."""
    from seft_ros.analysis.summary import reference_of, summarise_briefly  # which few tests need

    return summarise_briefly(recording, reference_of(recording))["displacement"]["nrmse"]
