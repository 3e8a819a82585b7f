"""Whatever happens to a bag's files: what is reported is right, and what is wrong is named."""

import random
import shutil

import numpy as np
import pytest
from experiments_at_hand import load
from mcap.writer import CompressionType, Writer
from recordings_at_hand import assert_same_samples
from seft_msgs_py.errors import InputError
from seft_ros.bags.bag_files import Bag, recover_bag
from seft_ros.bags.recording_bag import read_bag, write_recording
from seft_ros.test_run.blocks import build_blocks
from seft_ros.test_run.offline import simulate_test

WORDS = ("ground_motion:synthetic.duration:=2.0", "ground_motion:tail:=0.0")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A bag of a short test, in some ten chunks, and its recording."""
    experiment = load(*WORDS)
    blocks = build_blocks(experiment)
    path = tmp_path_factory.mktemp("whole") / "bag"
    write_recording(simulate_test(experiment, blocks), path, blocks.ground_motion.chunks)
    return path, read_bag(path)


def part(draw, raw):
    """A range of the file: anywhere, or at its head or end, from a byte to many chunks."""
    length = draw.choice((1, 4, 8, 40, 200, 5000, 100_000))
    at = draw.choice((draw.randrange(len(raw)), 0, 8, max(0, len(raw) - length)))
    return slice(at, min(len(raw), at + length))


def size(where):
    return where.stop - where.start


def put(raw, where, data):
    raw[where] = data


def swap(draw, raw, where):
    other = draw.randrange(len(raw) - size(where) + 1)
    other = slice(other, other + size(where))
    raw[where], raw[other] = raw[other], raw[where]


def shorten(draw, raw, where):
    del raw[where.start :]


def flip(draw, raw, where):
    raw[where.start] ^= 1 << draw.randrange(8)


DAMAGES = {
    "zeroed": lambda draw, raw, where: put(raw, where, bytes(size(where))),
    "noise": lambda draw, raw, where: put(raw, where, draw.randbytes(size(where))),
    "a flipped bit": flip,
    "cut off": shorten,
    "a lost part": lambda draw, raw, where: put(raw, where, b""),
    "a part that is there twice": lambda draw, raw, where: put(raw, where, 2 * raw[where]),
    "two parts that changed places": swap,
    "another file behind it": lambda draw, raw, where: put(raw, slice(None), raw + raw),
}


def damage(path, kind, seed):
    """Damage one of a bag's files; tell whether that has changed anything."""
    draw = random.Random(f"{kind} {seed}")
    file = path / draw.choice(("bag.mcap", "bag.mcap", "bag.mcap", "metadata.yaml"))
    before = file.read_bytes()
    raw = bytearray(before)
    DAMAGES[kind](draw, raw, part(draw, raw))
    file.write_bytes(raw)
    return raw != before


def assert_part_of(recording, original):
    """Every sample of a recording is the original's, bit for bit."""
    for name, series in recording.series.items():
        known = original.series[name]
        assert np.isin(series.steps, known.steps).all()
        np.testing.assert_array_equal(series.values, known.of_steps(series.steps).values)


@pytest.mark.parametrize("kind", list(DAMAGES))
def test_what_is_read_is_right_and_recover_agrees(whole, tmp_path, kind):
    source, original = whole
    for seed in range(4):
        path = tmp_path / str(seed) / "bag"
        shutil.copytree(source, path)
        changed = damage(path, kind, seed)
        try:
            recording = read_bag(path, damaged=True)
        except InputError as error:
            assert "damaged" in str(error) or "nothing of the bag can be read" in str(error)
            with pytest.raises(InputError):
                read_bag(path)
            continue
        assert_part_of(recording, original)
        assert bool(recording.damage) == changed
        before = (path / "bag.mcap").read_bytes()
        recovery = recover_bag(path)
        assert (recovery.original is None) == (not changed)
        if changed:
            assert recovery.original == path.with_name("bag.cut")
            assert (recovery.original / "bag.mcap").read_bytes() == before
        assert recover_bag(path).original is None
        assert {entry.name for entry in path.iterdir()} == {"bag.mcap", "metadata.yaml"}
        assert not path.with_name("bag.recovering").exists()
        whole_again = read_bag(path)
        assert whole_again.damage == recording.damage
        assert_same_samples(whole_again, recording)


@pytest.mark.parametrize("chunks", [False, True])
def test_a_test_that_another_program_has_written_anew_is_the_same(whole, tmp_path, chunks):
    source, original = whole
    file = tmp_path / "bag.mcap"
    with Bag(source) as bag, file.open("wb") as stream:
        writer = Writer(stream, use_chunking=chunks, compression=CompressionType.ZSTD)
        writer.start("", "another")
        channels = []
        for each in bag.sources.values():
            schema = writer.register_schema(each.type, each.encoding, each.definition.encode())
            channels.append(writer.register_channel(each.topic, each.serialization, schema))
        for block in bag.blocks({name: number for number, name in enumerate(bag.sources)}):
            for number, time_ns, raw in block.messages():
                writer.add_message(channels[number], time_ns, raw, time_ns)
        writer.finish()
    found = read_bag(file)
    assert (found.damage, found.checked) == ([], False)
    assert_same_samples(found, original)


def test_the_report_of_a_damaged_bag_names_what_is_missing(whole, seft, seft_json, tmp_path):
    source, original = whole
    path = tmp_path / "bag"
    shutil.copytree(source, path)
    raw = bytearray((path / "bag.mcap").read_bytes())
    for step, size in ((100, 200), (300, 5000)):
        at = raw.index(original.series["rig/state"].values[step, 0].tobytes())
        raw[at : at + size] = bytes(size)
    (path / "bag.mcap").write_bytes(raw)
    summary = seft_json("report", "bag", status=1)
    missing = [line for line in summary["damage"] if line.startswith("rig/state: ")]
    assert missing[0].startswith(f"rig/state: {summary['lost']['rig/state']} of ")
    assert " steps are missing, " in missing[0]
    page = (path / "report.html").read_text()
    assert "the bag is damaged" in page
    assert "fails its checksum" in page
    status, out, _ = seft("recover", "bag")
    assert status == 0
    assert set(summary["damage"]) >= set(out.splitlines()[:-1])
    again = seft_json("report", "bag", status=1)
    assert again["damage"] == summary["damage"]
    assert again["displacement"] == summary["displacement"]
    status, _, errors = seft("compare", "bag.cut", "bag", "--json")
    assert status == 0
    assert "bag.cut is damaged: bag.mcap: " in errors
