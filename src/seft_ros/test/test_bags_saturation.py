"""Saturation on its way: rig, offline record, status in the bag, record again, summary."""

from pathlib import Path

from seft_msgs_py.config.experiment import Experiment, parse_override
from seft_ros.analysis.judgement import verdict_line
from seft_ros.analysis.summary import summarise
from seft_ros.bags.record_bag import read_bag, write_record
from seft_ros.test_run.compiled_loop import build_blocks
from seft_ros.test_run.offline import simulate_test
from seft_ros.test_run.parameter_tables import TABLES

JHU = Path(__file__).parents[3] / "config" / "jhu.yaml"
WORDS = (
    "ground_motion:synthetic.duration:=8.0",
    "rig:sensors.force_range:=600",
    "supervisor:limits.saturated_time:=1e3",
)


def test_what_the_rig_counted_is_in_the_bag_and_in_its_summary(tmp_path):
    experiment = Experiment.load(TABLES, [JHU], [parse_override(word) for word in WORDS])
    blocks = build_blocks(experiment)
    record = simulate_test(experiment, blocks)
    force = abs(record.series["rig/state"].values[:, 3, 0])
    at_range = force >= 600 * (1 - 1e-9)
    assert at_range.any()
    expected = {"samples": int(at_range.sum()), "first_step": int(at_range.argmax())}
    write_record(record, tmp_path / "bag")
    for one in (record, read_bag(tmp_path / "bag")):
        assert one.saturation == blocks.rig.saturation
        assert summarise(one)["saturated"]["force_range"] == expected
        assert f"force range in {expected['samples']} samples from" in verdict_line(summarise(one))
