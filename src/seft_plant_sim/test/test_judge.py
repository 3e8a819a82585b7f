"""The judge of samples: wrong values are replaced, and no other."""

import math

import numpy as np
import pytest
from detector_samples import ALL, DT, MASS, NOISE, STIFFNESS, N, detect, detectors
from seft_plant_sim.judge import detectors as rows
from seft_plant_sim.judge.judge import judge_arrays
from seft_plant_sim.judge.judge_step import ask, begin_judge, judge

X, V, A, F = range(4)
DAMPING = np.array([[200.0, -20.0], [-20.0, 150.0]])
OIL = np.array([[1e7, 2.0], [2e7, 3.0]])
SIGMAS = 6.0
AT, LENGTH = 150, 300


def motion(seed=1, size=1.0):
    """Samples of two sines with noise, these without it, and the flow of the valves."""
    t = DT * np.arange(-1, LENGTH)[:, np.newaxis]
    found = []
    for k in range(3):  # x, v, a
        phase = 0.5 * np.pi * k
        parts = [
            of * w**k * np.sin(w * t + phase + shift)
            for of, w, shift in (
                (np.array([3e-3, 2e-3]), 2.0 * np.pi * 3.0, np.array([0.3, 1.0])),
                (np.array([4e-3, 5e-3]), 2.0 * np.pi * 8.0, np.array([2.0, 0.7])),
            )
        ]
        found.append(sum(parts))
    x, v, a = found
    f = x @ STIFFNESS + v @ DAMPING + a @ MASS
    flow = 0.5 * (v[1:] + v[:-1]) + (np.diff(f, axis=0) / DT + OIL[:, 1] * f[:-1]) / OIL[:, 0]
    right = np.stack([x, v, a, f], axis=1)[1:]
    rng = np.random.default_rng(seed)
    return right + size * NOISE * rng.normal(size=right.shape), right, flow


def fresh_judge(noise=NOISE, oil=OIL, mass=MASS, largest=np.inf, late=0.0):
    """A judge that has begun; ``largest`` is the acceleration's range, ``late`` the velocity."""
    ranges = np.full((4, N), np.inf)
    ranges[A] = largest
    p, state = judge_arrays(noise, oil, mass, STIFFNESS, ranges, late, SIGMAS, DT)
    begin_judge(state)
    return p, state


def judged_of(samples, flow, steps=None, mass=MASS, oil=OIL, largest=np.inf, asked=None):
    """Judge samples: the judged ones, and which values were replaced; ``asked`` are the forces."""
    known = np.zeros((N, N)) if mass is None else mass
    p, state = fresh_judge(oil=oil, mass=known, largest=largest)
    judged, verdicts = np.empty_like(samples), []
    for k, step in enumerate(range(len(samples)) if steps is None else steps):
        judge(p, state, step, samples[k], flow[k], judged[k])
        verdicts.append(state.verdict.copy())
        for i in range(N if asked is not None else 0):
            ask(p, state, i, asked[k, i])
    return judged, np.array(verdicts), p


def bounds(p):
    """Largest error of a replaced value, shape (4, n): noise of its relation, and its curvature."""
    noise = p.noise
    by_specimen = np.abs(np.linalg.inv(MASS)) @ (noise[3] + 60.0)
    return np.array([2.0 * noise[0], 2.0 * noise[1], by_specimen, noise[2] + noise[3]])


@pytest.mark.parametrize("size", [1.0, 0.3, 0.0])
@pytest.mark.parametrize(("mass", "oil"), [(MASS, OIL), (None, OIL), (MASS, 0.0 * OIL)])
def test_a_fault_free_recording_is_as_measured(mass, oil, size):
    for seed in range(5):
        samples, _, flow = motion(seed, size)
        judged, replaced, _ = judged_of(samples, flow, mass=mass, oil=oil)
        assert not replaced.any()
        np.testing.assert_array_equal(judged, samples)


@pytest.mark.parametrize("known", [1.0, 0.0])
def test_noise_is_six_times_what_it_makes_of_each_relation(known):
    rms, oil = np.array([[1e-6], [2e-3], [1.0], [40.0]]) * np.array([1.0, 2.0]), known * OIL
    p, _ = fresh_judge(rms, oil)
    samples = rms * np.random.default_rng(1).normal(size=(20000, 4, N))
    x, v, a, f = np.moveaxis(samples, 1, 0)
    moved, gained = DT * 0.5 * (v[1:] + v[:-1]), DT * 0.5 * (a[1:] + a[:-1])
    force = np.diff(f, axis=0) + oil[:, 0] * moved if known else np.diff(f, n=2, axis=0)
    off = np.diff(x, axis=0) - moved, np.diff(v, axis=0) - gained, force
    found = [each.std(axis=0) for each in (*off, np.diff(f - a @ MASS, n=2, axis=0))]
    np.testing.assert_allclose(p.noise, SIGMAS * np.array(found), rtol=0.02)


def test_what_is_recent_fades():
    p, state = fresh_judge(oil=0.0 * OIL)
    kept = state.moves, state.usual, state.jump, state.doubt
    for step in range(26):
        judge(p, state, step, np.zeros((4, N)), np.zeros(N), np.zeros((4, N)))
        for each in kept if step == 0 else ():
            each[:] = 1.0
    lasts = np.exp(-25.0 * DT / np.array([0.05, 0.05, 0.3, 0.3, 0.3, 3.0, 1e-9]))
    np.testing.assert_allclose(np.vstack(kept), np.transpose([lasts] * N), rtol=1e-9)


LARGEST = np.abs(motion()[1]).max(axis=0)
WRONG = {
    "by its peak": lambda value, peak: value + peak,
    "by minus three peaks": lambda value, peak: value - 3.0 * peak,
    "nan": lambda value, peak: math.nan,
    "inf": lambda value, peak: math.inf,
    "zero": lambda value, peak: 0.0,
    "flipped": lambda value, peak: -value,
}


@pytest.mark.parametrize("length", [1, 2])
@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_wrong_value_is_replaced_by_one_near_the_true_one_and_no_other_is(
    row, axis, wrong, length
):
    if row == 3 and wrong == "zero":
        length = 1  # a second one must stand out of what the first replacement may be wrong by
    samples, right, flow = motion()
    at = 100 + int(np.abs(right[100:200, row, axis]).argmax())  # where zero is wrong
    faulty = samples.copy()
    for k in range(at, at + length):
        faulty[k, row, axis] = WRONG[wrong](samples[k, row, axis], LARGEST[row, axis])
    judged, replaced, p = judged_of(faulty, flow)
    expected = np.zeros_like(replaced)
    expected[at : at + length, row, axis] = 1
    np.testing.assert_array_equal(replaced, expected)
    off = np.abs(judged - right)[at : at + length, row, axis]
    assert (off < length * bounds(p)[row, axis]).all()
    others = expected == 0
    np.testing.assert_array_equal(judged[others], samples[others])


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_three_wrong_values_within_50_ms_end_the_test(row, axis):
    for apart, ends in ((1, True), (12, True), (13, False)):
        p, state = detectors(ALL[: rows.WRONG], actuator=np.zeros((N, 4)))
        samples, _, _ = motion()
        found = []
        for k in range(LENGTH):
            raw = samples[k].copy()
            if k in (AT, AT + apart, AT + 2 * apart):
                raw[row, axis] = math.nan
            found.append(detect(p, state, k, raw))
            if found[-1] >= 0:
                break
        assert state.judge.counts[row, axis] == 3
        code = (rows.WRONG + row) * N + axis
        assert (found[-1] == code) == ends
        assert (len(found) == AT + 2 * apart + 1) == ends


@pytest.mark.parametrize("part", [0.99, 1.01])
@pytest.mark.parametrize("row", [X, V, F])
def test_what_turns_at_any_time_between_two_samples_is_allowed(row, part):
    """A late velocity, the specimen's force, or the velocity, as seen by the oil."""
    p, state = fresh_judge(late=0.02 if row == X else 0.0)
    raw, flow = np.zeros((4, N)), np.zeros(N)
    for step in (0, 1):
        judge(p, state, step, raw, flow, np.zeros((4, N)))
    state.moves[2] = 1e5
    if row == X:
        raw[V, 1], flow[1] = 0.005, 0.0025
        raw[X, 1] = DT * 0.0025 + part * (p.noise[0, 1] + 0.02 * 0.005)
    elif row == V:
        raw[F, 1], turned = 1000.0, abs(np.linalg.solve(MASS, [0.0, 1000.0])[1])
        raw[V, 1] = part * (p.noise[1, 1] + 0.5 * DT * turned)
        flow[1] = 0.5 * raw[V, 1] + 1000.0 / (DT * OIL[1, 0])
    else:
        raw[A, 1] = -2.0
        raw[F, 1] = part * (2.0 / 3.0 * p.noise[2, 1] + OIL[1, 0] * 0.125 * DT**2 * 2.0)
    judge(p, state, 2, raw, flow, np.zeros((4, N)))
    assert state.verdict.sum() == state.verdict[row, 1] == (part > 1.0)


@pytest.mark.parametrize(("wrong_at", "left"), [([], 0), ([0], 1), ([1], 0)])
def test_a_jump_that_lasts_takes_back_the_last_sample_if_it_was_counted(wrong_at, left):
    p, state = fresh_judge()
    raw = np.zeros((4, N))
    for step in (0, 1):
        judge(p, state, step, raw, raw[V], np.zeros((4, N)))
    state.off[3, 1], state.counts[A, 1] = 50.0, len(wrong_at)
    state.wrong[A, 1, : len(wrong_at)] = wrong_at
    raw[A, 1], raw[V, 1] = 50.0, 0.5 * DT * 50.0
    judge(p, state, 2, raw, 0.5 * raw[V], np.zeros((4, N)))
    assert state.counts[A, 1] == left == (state.wrong[A, 1] >= 0).sum()


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("part", [0.0, 0.3, 0.7, 0.95])
def test_a_stop_is_accepted_at_once_or_one_sample_later(part, sign):
    """The acceleration jumps at a part of the period before a sample, and the velocity follows."""
    samples, _, flow = motion()
    jump = sign * np.linalg.solve(MASS, [4000.0, 0.0])  # of the specimen's force on the first axis
    t = DT * np.maximum(np.arange(LENGTH) - AT + 1 - part, 0.0)[:, np.newaxis]
    lasts = np.minimum(t, 10 * DT)
    moved = 0.5 * lasts**2 + lasts * (t - lasts)
    samples = samples + np.stack(
        [moved * jump, lasts * jump, ((t > 0.0) & (t <= 10 * DT)) * jump, 0.0 * t * jump], axis=1
    )
    flow[1:] += 0.5 * (lasts[1:] + lasts[:-1]) * jump
    _, replaced, _ = judged_of(samples, flow)
    for axis in range(N):
        assert not replaced[:, [X, V, F], axis].any()
        assert set(np.flatnonzero(replaced[:, A, axis])) <= {AT, AT + 10, AT + 11}


def test_a_force_that_turns_as_was_asked_is_not_wrong_though_the_specimen_sticks():
    samples, asked = np.zeros((LENGTH, 4, N)), np.zeros((LENGTH, N))
    for first, change in ((100, 200.0), (104, -500.0), (108, 700.0)):
        asked[first:, 1] += change
    samples[5:, F] = asked[:-5]  # the delay of the rig
    flow = np.zeros((LENGTH, N))
    judged, replaced, _ = judged_of(samples, flow, oil=0.0 * OIL, asked=asked)
    assert not replaced.any()
    np.testing.assert_array_equal(judged, samples)
    _, replaced, p = judged_of(samples, flow, oil=0.0 * OIL)
    assert replaced[[105, 109], F, 1].all()
    for part in (0.99, 1.01):  # what was asked until step 101, and noise
        samples[103, F, 1] = part * (200.0 * p.recent + 2.0 / 3.0 * p.noise[2, 1])
        _, replaced, _ = judged_of(samples[:104], flow, oil=0.0 * OIL, asked=asked)
        assert replaced.any() == (part > 1.0)


def test_no_force_is_judged_by_an_acceleration_at_the_end_of_its_range():
    samples, _, flow = motion()
    end = 0.9 * np.abs(samples[:, A]).max()
    last = int(np.flatnonzero((np.abs(samples[:, A]) >= end).any(axis=1))[-1])
    for after in range(4):
        wrong = samples[: last + after + 1].copy()
        wrong[-1, F] += 300.0
        assert judged_of(wrong, flow)[1][-1, F].all()
        assert judged_of(wrong, flow, largest=end)[1][-1, F].all() == (after > 2)


@pytest.mark.parametrize("part", [0.99, 1.01])
def test_the_first_step_of_a_coarse_converter_is_not_wrong(part):
    p, state = fresh_judge()
    p.range[X], raw = 0.1, np.zeros((4, N))
    for step in range(3):
        raw[X, 1] = part * (p.noise[0, 1] + 2.0 * 0.1 / 128.0) if step == 2 else 0.0
        judge(p, state, step, raw, raw[V], np.zeros((4, N)))
    assert state.verdict.sum() == state.verdict[X, 1] == (part > 1.0)


def test_an_acceleration_at_the_end_of_its_range_says_nothing_of_the_velocity():
    samples, _, flow = motion()
    end = 0.4 * np.abs(samples[:, A]).max()
    samples[:, A] = np.clip(samples[:, A], -end, end)
    assert judged_of(samples, flow)[1][:, V].any()
    assert not judged_of(samples, flow, largest=end)[1][:, V].any()


@pytest.mark.parametrize("hertz", [60.0, 90.0])
def test_an_oil_column_that_rings_between_few_samples_is_no_wrong_velocity(hertz):
    samples, _, flow = motion(size=0.0)
    w = 2.0 * math.pi * 2.0 * hertz  # of 250 Hz
    phase = w * DT * np.arange(LENGTH)[:, np.newaxis] * np.ones(N)
    ringing = 40.0 * np.stack([-np.sin(phase) / w**2, -np.cos(phase) / w, np.sin(phase)], axis=1)
    samples[:, :F] += ringing
    samples[:, F] += ringing[:, A] @ MASS + ringing[:, V] @ DAMPING + ringing[:, X] @ STIFFNESS
    assert not judged_of(samples, flow)[1][:, V].any()


def test_after_a_lost_sample_nothing_is_compared():
    samples, _, flow = motion()
    faulty = samples.copy()
    faulty[AT] += 2.0 * LARGEST
    steps = [*range(AT), AT + 1]
    judged, replaced, _ = judged_of(faulty[: AT + 1], flow, steps)
    assert not replaced.any()
    np.testing.assert_array_equal(judged, faulty[: AT + 1])
    faulty[AT, F, 1] = math.nan
    judged, replaced, _ = judged_of(faulty[: AT + 1], flow, steps)
    assert replaced.sum() == replaced[AT, F, 1] == 1
    assert judged[AT, F, 1] == samples[AT - 1, F, 1]


@pytest.mark.parametrize(
    ("row", "mass", "oil"),
    [
        *((row, None, OIL) for row in (X, V)),
        *((row, MASS, 0.0 * OIL) for row in (X, V, A, F)),
        *((row, None, 0.0 * OIL) for row in (X, V)),
    ],
)
@pytest.mark.parametrize("axis", [0, 1])
def test_with_less_known_spikes_are_found_where_the_equations_allow(row, axis, mass, oil):
    samples, right, flow = motion()
    for sign in (1.0, -1.0):
        faulty = samples.copy()
        faulty[AT, row, axis] += sign * LARGEST[row, axis]
        judged, replaced, _ = judged_of(faulty, flow, mass=mass, oil=oil)
        assert replaced.sum() == replaced[AT, row, axis] == 1
        assert abs(judged[AT, row, axis] - right[AT, row, axis]) < 0.1 * LARGEST[row, axis]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("row", range(4))
def test_a_first_value_that_is_no_number_is_taken_as_0(row, value):
    samples, _, flow = motion()
    samples[0, row, 1] = value
    judged, replaced, _ = judged_of(samples[:1], flow)
    assert replaced.sum() == replaced[0, row, 1] == 1
    assert judged[0, row, 1] == 0.0
