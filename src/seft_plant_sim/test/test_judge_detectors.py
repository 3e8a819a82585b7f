"""Detectors, sample by sample: what each sees, its threshold, and what comes of it."""

import math

import numpy as np
import pytest
from detector_samples import (
    ACTUATOR,
    ALL,
    DT,
    LIMITS,
    NOISE,
    N,
    detect,
    detectors,
    noise_of_a_rig,
    numbers_of,
    of_what,
    shares_of,
)
from seft_msgs_py.config.facts import CHANNELS
from seft_plant_sim.channels import Derivation
from seft_plant_sim.judge import detectors as rows
from seft_plant_sim.judge.channel_relations import find_flow
from seft_plant_sim.judge.detector_list import DETECTORS, describe
from seft_plant_sim.judge.detector_step import SAME, begin_detectors, detect_all
from seft_plant_sim.judge.detectors import FROZEN, SUSPECT, VALID, look
from seft_plant_sim.judge.relation_following import uncertain


def test_a_new_test_knows_nothing_of_the_one_before():
    samples, commands = noise_of_a_rig(60, size=40.0)
    samples[20:40:2, 0, 1] = samples[21:41:2, 0, 1]
    found = []
    for _ in range(2):
        p, state = detectors(ALL)
        for values in (*state[:-1], *state.judge[:-1]) if found else ():
            values.view(values.dtype if values.dtype.names is None else np.int64)[:] = 7
        state.found[:] = 0.0  # it is reported only at a trip
        begin_detectors(p, state)
        seen = shares_of(p, state, samples, commands)
        found.append((seen, *numbers_of(state)))
    for fresh, again in zip(*found, strict=True):
        np.testing.assert_array_equal(again, fresh)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("name", [*ALL[:3], "force_jump"])
def test_what_a_detector_finds_is_reported_by_row_and_axis(name, axis):
    p, state = detectors([each for each in ALL if each != name])
    samples, commands = of_what(name, axis)
    found = []
    for k in range(100):
        found.append(detect(p, state, 1 + k, samples[k], commands[max(k - 1, 0)]))
    first = next(k for k, each in enumerate(found) if each >= 0)
    assert found[first] == ALL.index(name) * N + axis
    assert set(found[:60]) == {VALID}
    assert 60 < first <= 60 + 2 * p.persistence[ALL.index(name)] + 2


@pytest.mark.parametrize("axis", [0, 1])
def test_of_several_that_find_something_the_first_is_reported(axis):
    p, state = detectors()
    samples, _ = noise_of_a_rig(12, size=0.3)
    samples[5:, 0, axis] += 0.02
    samples[5:, 1, axis] += 5.0
    found = [detect(p, state, k, samples[k]) for k in range(8)]
    assert state.judge.counts[:, axis].tolist() == [3, 3, 0, 0, 3, 3]
    assert found[5:] == [VALID, rows.SUSPECT, rows.WRONG * N + axis]


def test_a_detector_acts_once_it_is_beyond_its_threshold_for_its_persistence():
    p, state = detectors(["oil_balance"])
    row, lasts = rows.DIFFERS, p.persistence[rows.DIFFERS]
    assert lasts == 3
    seen = [1.0, 1.5, 1.25, 1.0, 0.5, 1.5, 1.5, 1.5, 1.75]
    found = [look(p, state, row, 1, 2.0 * each, 2.0) for each in seen]
    assert found == [VALID] * 7 + [row * N + 1] * 2
    assert state.found[:, row, 1].tolist() == [3.5, 2.0]
    assert look(p, state, row, 0, 9.0, 0.0) == VALID  # a threshold of nothing is none
    assert state.shares[row].tolist() == [0.0, 1.75]
    assert state.counts[row].tolist() == [0, 4]
    assert {look(p, state, rows.OIL, 0, 9.0, 1.0) for _ in range(99)} == {VALID}  # it warns
    assert state.shares[rows.OIL, 0] == 9.0


def test_persistences_in_samples():
    p, _ = detectors(["oil_balance", "force_jump"])
    lasts = dict(zip((one.name for one in DETECTORS), p.persistence.tolist(), strict=True))
    assert lasts.pop("force_jump") == 2
    for name in CHANNELS:
        assert lasts.pop(f"{name}_frozen") == lasts.pop(f"{name}_wrong") == 1
    assert set(lasts.values()) == {3}
    rare, _ = detectors(dt=0.004)
    lasts = dict(zip((one.name for one in DETECTORS), rare.persistence.tolist(), strict=True))
    assert {lasts[name] for name in ALL[:4]} == {3}
    assert (lasts["force_jump"], lasts["force_frozen"]) == (2, 1)
    only_warn = [one.name for one, acts in zip(DETECTORS, p.acts, strict=True) if not acts]
    assert only_warn == ["oil_balance", "force_jump"]
    assert set(p.acts) == {0, 1}


@pytest.mark.parametrize("missing", [1, 2])
def test_where_a_sample_was_lost_nothing_is_compared(missing):
    p, state = detectors()
    samples, commands = noise_of_a_rig(40)
    whole = shares_of(p, state, samples, commands)
    begin_detectors(p, state)
    lost = shares_of(p, state, samples, commands, [*range(20), *range(20 + missing, 40 + missing)])
    np.testing.assert_array_equal(lost[:20], whole[:20])
    assert not lost[20].any()
    assert lost[21].any()


@pytest.mark.parametrize("row", range(4))
def test_a_channel_at_the_end_of_its_range_is_compared_with_nothing_until_it_is_back(row):
    ranges = np.zeros((4, N))
    ranges[row, 1] = 1e3
    p, state = detectors([one.name for one in DETECTORS], ranges=ranges)
    samples, commands = noise_of_a_rig(12)
    samples[5, row, 1] = -1e3
    seen = shares_of(p, state, samples, commands)
    watched = {0: (0, 2), 1: (0, 1, 2), 2: (1,), 3: (2,)}[row]
    blind = np.array([not seen[k, watched].any() for k in range(1, 12)])
    assert blind.tolist() == [k in (5, 6) for k in range(1, 12)]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_drift_makes_a_sample_suspect_before_it_ends_the_test(sign):
    p, state = detectors()
    samples, _ = noise_of_a_rig(40, size=0.3)
    samples[5:, 0, 1] += sign * 5e-5 * np.arange(35)
    found = [detect(p, state, k, samples[k]) for k in range(40)]
    first = found.index(rows.DIFFERS * N + 1)
    assert found[: first - 2] == [VALID] * (first - 2)
    assert found[first - 2 : first] == [SUSPECT] * 2
    assert not state.judge.counts.any()


def test_a_detector_that_only_warns_puts_nothing_under_suspicion():
    p, state = detectors([one.name for one in DETECTORS])
    samples, _ = noise_of_a_rig(20, size=0.3)
    samples[5:, :, 1] += 100.0 * NOISE[:, 1]
    assert {detect(p, state, k, samples[k]) for k in range(20)} == {VALID}
    assert state.shares.max() > 1.0


@pytest.mark.parametrize("row", range(4))
def test_a_channel_at_the_end_of_its_range_is_not_frozen(row):
    ranges = np.zeros((4, N))
    ranges[row, 0] = 1e3
    p, state = detectors(ALL, ranges=ranges)
    samples, commands = noise_of_a_rig(60, size=0.3)
    samples[20:, row, 0] = 1e3
    assert not shares_of(p, state, samples, commands)[:, rows.FROZEN + row].any()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_channel_that_repeats_a_value_is_frozen_once_that_is_no_chance(row, axis):
    p, state = detectors([each for each in ALL if not each.endswith("_frozen")])
    samples, _ = noise_of_a_rig(60, size=0.3)
    step = 0.2 * NOISE[row, axis]
    samples[:, row, axis] = step * (np.arange(60) // 2 % 2)
    samples[30:, row, axis] = step
    most = math.log(SAME) / math.log(0.2 / (2.0 * math.sqrt(math.pi)))
    frozen = rows.FROZEN + row
    for k in range(60):
        state.shares[:] = 0.0
        found = detect(p, state, k, samples[k])
        same = k - 30 if k > 30 else k % 2
        expected = same / most if k > 2 else 0.0
        assert state.shares[frozen, axis] == pytest.approx(expected, rel=1e-9)
        if found >= 0:
            assert found == frozen * N + axis
            assert k == 30 + math.floor(most) + 1
            break
        assert found == (SUSPECT if same > 2.0 * most / 3.0 else VALID)
    assert found >= 0


def test_channels_that_freeze_together_are_frozen_sooner():
    p, state = detectors([each for each in ALL if not each.endswith("_frozen")])
    samples, _ = noise_of_a_rig(60, size=0.3)
    steps = 0.2 * NOISE[:2, 1]
    samples[:30, :2, 1] = steps * (np.arange(30)[:, np.newaxis] // 2 % 2)
    samples[30:, :2, 1] = steps
    most = math.log(SAME) / math.log(0.2 / (2.0 * math.sqrt(math.pi)))
    found = [detect(p, state, k, samples[k]) for k in range(30 + math.floor(0.5 * most) + 2)]
    assert found[-1] == rows.FROZEN * N + 1
    assert max(found[:-1]) < 0


def test_a_whole_test_gives_the_shares_of_its_samples():
    p, state = detectors()
    samples, drives = noise_of_a_rig(50)
    expected, steps = [], np.array([*range(30), *range(33, 53)])
    for k, step in enumerate(steps):
        detect(p, state, step, samples[k], drives[k])
    expected = numbers_of(state)
    begin_detectors(p, state)
    detect_all(p, state, steps, samples, drives, np.empty((4, N)))
    for values, again in zip(expected, numbers_of(state), strict=True):
        np.testing.assert_array_equal(values, again)


def test_a_valve_without_gain_or_oil_and_a_specimen_without_stiffness_are_not_known():
    actuator = ACTUATOR.copy()
    actuator[0, 0] = actuator[1, 1] = actuator[1, 3] = 0.0
    p, _ = detectors(actuator=actuator, ranges=np.full((4, N), 0.5))
    assert np.isinf(p.sums[rows.OIL]).all()
    np.testing.assert_array_equal(p.rig.actuator[:, 3], [2e4, np.inf])
    np.testing.assert_array_equal(p.rig.ranges, 0.5)
    for unknown in ("mass", "stiffness"):
        assert np.isinf(detectors(**{unknown: np.zeros((N, N))})[0].rough).all()


def test_what_is_not_known_of_the_hardware_is_not_watched():
    nothing, names = np.zeros((N, N)), [one.name for one in DETECTORS]
    unknown = {"noise": np.zeros((4, N)), "mass": nothing, "stiffness": nothing}
    p, state = detectors(actuator=np.zeros((N, 4)), **unknown)
    np.testing.assert_allclose(p.noise, 1e-3 * LIMITS[:, np.newaxis] * np.ones(N))
    samples, commands = noise_of_a_rig(50, size=0.1)
    seen = shares_of(p, state, samples, commands).max(axis=(0, 2))
    watched = {name for name, share in zip(names, seen, strict=True) if share > 0.0}
    assert watched == set(names[:2])
    derived, _ = detectors(derivation=Derivation(1.0 / 0.002, 0.0))
    np.testing.assert_allclose(derived.noise[1], math.sqrt(2.0) * NOISE[0] / DT)


@pytest.mark.parametrize("drive", [8.0, 10.0, -10.0])
def test_a_valve_that_is_open_opens_no_further(drive):
    overshoots = np.array([[[0.9, 0.2, 0.1], [0.0, 0.0, 0.0]]] * N)
    p, state = detectors(past=overshoots)
    for step in range(4):
        detect(p, state, step, np.zeros((4, N)), np.full(N, drive))
    open_by, further = ACTUATOR[:, 0] * drive, 0.0 if abs(drive) < 9.0 else 0.1
    np.testing.assert_allclose(state.mean[0], (1.2 - further) * open_by, rtol=1e-9)
    for i in range(N):
        known = uncertain(state.covariance[rows.OIL, i], 1.2 * open_by[i], 0.0, 1.0)
        assert state.mean[1, i] == pytest.approx(known + (further * open_by[i]) ** 2, rel=1e-3)


def test_of_detectors_that_act_at_once_each_says_what_it_saw_and_where():
    p, state = detectors()
    for _ in range(3):
        look(p, state, rows.DIFFERS, 1, 0.01234, 0.005)
        look(p, state, rows.FROZEN + 3, 0, 21.0, 12.5)
    assert describe(DETECTORS[rows.DIFFERS], state.found[:, rows.DIFFERS, 1], "north") == (
        "measured displacement and velocity disagree on axis north: they differ by 0.0123 m over "
        "the last 50 ms (0.005 m allowed): displacement_velocity"
    )
    frozen = rows.FROZEN + 3
    assert describe(DETECTORS[frozen], state.found[:, frozen, 0], "east") == (
        "measured force on axis east has repeated one value for 21 samples "
        "(12.5 samples allowed): force_frozen"
    )


# ---- What detectors keep from sample to sample


@pytest.mark.parametrize(
    ("lost", "held"),
    [
        (0, [5.0, 1.0, 2.0, 3.0]),
        (1, [5.0, 1.0, 1.0, 2.0]),
        (2, [5.0, 1.0, 1.0, 1.0]),
        (9, [5.0, 1.0, 1.0, 1.0]),
    ],
)
def test_of_lost_samples_the_last_command_was_held(lost, held):
    rng = np.random.default_rng(1)
    past = rng.normal(size=(N, 2, 4))
    p, state = detectors(past=past)
    state.sent[:] = [[1.0, 2.0, 3.0, 4.0], [10.0, 20.0, 30.0, 40.0]]
    find_flow(p, state, lost, np.array([5.0, 50.0]))
    sent = np.outer([1.0, 10.0], held)
    np.testing.assert_array_equal(state.sent, sent)
    found = ACTUATOR[:, 0] * (past * sent[:, np.newaxis]).sum(axis=2).T
    np.testing.assert_allclose(state.flow, found, rtol=1e-12)


@pytest.mark.parametrize("chance", [0.1, 0.499, 0.5, 0.7, 1.5])
def test_of_a_sensor_coarser_than_its_noise_no_value_is_frozen(chance):
    p, state = detectors()
    coarse = chance * 2.0 * math.sqrt(math.pi) * NOISE[0, 0]
    for step, value in enumerate((0.0, coarse, coarse)):
        measured = np.zeros((4, N))
        measured[0, 0] = value
        state.shares[:] = 0.0
        detect(p, state, step, measured)
    share = math.log(chance) / math.log(SAME) if chance < 0.5 else 0.0
    assert state.shares[FROZEN, 0] == pytest.approx(share, rel=1e-9)
