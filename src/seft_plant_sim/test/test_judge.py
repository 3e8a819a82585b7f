"""The judge of samples: wrong values are replaced, no other, and what was decided is revised."""

import math

import numpy as np
import pytest
from detector_samples import ALL, DT, MASS, NOISE, STIFFNESS, N, detect, detectors
from seft_plant_sim.channels import Derivation, derive_velocity
from seft_plant_sim.judge import detectors as rows
from seft_plant_sim.judge.hypotheses import (
    BREAKS,
    factorise,
    log_opposed,
    product,
    whiten,
)
from seft_plant_sim.judge.judge import BRANCH, REVISED, judge_arrays
from seft_plant_sim.judge.judge_step import ask, begin_judge, go_on, judge, oppose

X, V, A, F = range(4)
DAMPING = np.array([[200.0, -20.0], [-20.0, 150.0]])
OIL = np.array([[1e7, 2.0], [2e7, 3.0]])
AT, LENGTH = 150, 300
REST = np.array([np.zeros((4, N)), math.sqrt(5.0) * NOISE])
MEASURED = Derivation(0.0, 0.0)
WIDE = np.array([[0.1], [2.0], [200.0], [2e4]]) * np.ones(N)


def motion(seed=1, size=1.0, mass=MASS):
    """Samples of two sines that begin at rest with noise, without it, and the valves' flow."""
    t = DT * np.arange(LENGTH)[:, np.newaxis]
    x, v, a = np.zeros((3, LENGTH, N))
    for of, w in ((np.array([3e-3, 2e-3]), 6.0 * np.pi), (np.array([4e-3, 5e-3]), 16.0 * np.pi)):
        x += of * (1.0 - np.cos(w * t))
        v += of * w * np.sin(w * t)
        a += of * w**2 * np.cos(w * t)
    fades = 1.0 - np.exp(-((t / 0.05) ** 3))
    a, v = a * fades, np.zeros((LENGTH, N))
    v[1:] = np.cumsum(0.5 * DT * (a[1:] + a[:-1]), axis=0)
    x = np.zeros((LENGTH, N))
    x[1:] = np.cumsum(0.5 * DT * (v[1:] + v[:-1]) - DT**2 / 12.0 * (a[1:] - a[:-1]), axis=0)
    f = x @ STIFFNESS + v @ DAMPING + a @ mass
    moved = np.diff(x, axis=0) / DT
    flow = np.zeros((LENGTH, N))
    flow[1:] = moved + (np.diff(f, axis=0) / DT + OIL[:, 1] * f[:-1]) / OIL[:, 0]
    right = np.stack([x, v, a, f], axis=1)
    rng = np.random.default_rng(seed)
    return right + size * NOISE * rng.normal(size=right.shape), right, flow


def fresh_judge(oil=OIL, mass=MASS, ranges=WIDE, rest=REST, derivation=MEASURED, imposed=0):
    """A judge that has begun."""
    steps, imposed = np.full((4, N), np.inf), np.full(N, imposed, np.int64)
    late = 2e-3 if derivation.gain else 0.0
    known = NOISE, rest, oil, mass, STIFFNESS, ranges, steps
    p, state = judge_arrays(*known, late, derivation, imposed, DT)
    begin_judge(p, state)
    return p, state


def judged_of(samples, flow, steps=None, asked=None, **known):
    """Judge samples: the judged ones, which values were replaced, and the state."""
    p, state = fresh_judge(**known)
    judged, verdicts = np.empty_like(samples), []
    for k, step in enumerate(range(len(samples)) if steps is None else steps):
        judge(p, state, step, samples[k], np.array([flow[k], 0.0 * flow[k]]), judged[k])
        verdicts.append(state.sets[k % len(state.sets)] >> np.arange(4)[:, np.newaxis] & 1)
        for i in range(N if asked is not None else 0):
            ask(p.axes[i], state.axes[i], asked[k, i])
    return judged, np.array(verdicts), state


NOTHING = np.zeros((N, N))


@pytest.mark.parametrize("size", [1.0, 0.3, 0.0])
@pytest.mark.parametrize(("mass", "oil"), [(MASS, OIL), (NOTHING, OIL), (MASS, 0.0 * OIL)])
def test_a_fault_free_recording_is_as_measured(mass, oil, size):
    for seed in range(5):
        samples, _, flow = motion(seed, size)
        judged, replaced, state = judged_of(samples, flow, mass=mass, oil=oil)
        assert not replaced.any()
        np.testing.assert_array_equal(judged, samples)
        assert (state.axes.count == 1).all()


def test_chi_squared_is_that_of_the_covariance():
    rng = np.random.default_rng(1)
    p, state = fresh_judge()
    room = state.room[0]
    for _ in range(9):
        root, off = rng.normal(size=(4, 4)), rng.normal(size=4)
        covariance = root @ root.T
        expected = off @ np.linalg.solve(covariance, off)
        room.covariance[:], room.off[:] = np.tril(covariance), off
        det = whiten(p.axes[0], room)
        assert det == pytest.approx(np.linalg.det(covariance), rel=1e-6)
        assert product(room, 6, 6) == pytest.approx(expected, rel=1e-6)


LARGEST = np.abs(motion()[1]).max(axis=0)
WRONG = {
    "by its peak": lambda value, peak: value + peak,
    "by minus three peaks": lambda value, peak: value - 3.0 * peak,
    "nan": lambda value, peak: math.nan,
    "inf": lambda value, peak: math.inf,
    "zero": lambda value, peak: 0.0,
    "flipped": lambda value, peak: -value,
}
NEAR = np.array([1e-4, 0.02, 2.0, 100.0])
"""Largest error of a replaced value: a few times what noise and curvature make of it."""


@pytest.mark.parametrize("wrong", WRONG)
@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("row", range(4))
def test_a_wrong_value_is_replaced_by_one_near_the_true_one_and_no_other_is(row, axis, wrong):
    samples, right, flow = motion(mass=np.diag(np.diag(MASS)))
    at = 100 + int(np.abs(right[100:200, row, axis]).argmax())  # where zero is wrong
    faulty = samples.copy()
    faulty[at, row, axis] = WRONG[wrong](samples[at, row, axis], LARGEST[row, axis])
    judged, replaced, _ = judged_of(faulty, flow, mass=np.diag(np.diag(MASS)))
    expected = np.zeros_like(replaced)
    expected[at, row, axis] = 1
    np.testing.assert_array_equal(replaced, expected)
    assert abs(judged[at, row, axis] - right[at, row, axis]) < NEAR[row]
    others = expected == 0
    np.testing.assert_array_equal(judged[others], samples[others])


@pytest.mark.parametrize("channels", [(X, F), (V, A), (A, F), (X, V, A, F)])
def test_several_wrong_values_of_one_sample_are_replaced(channels):
    samples, right, flow = motion()
    faulty = samples.copy()
    for row in channels:
        faulty[AT, row, 0] += 2.0 * LARGEST[row, 0]
    judged, replaced, _ = judged_of(faulty, flow)
    assert replaced[AT, list(channels), 0].all()
    assert not replaced[:AT].any() and not replaced[AT + REVISED + 1 :].any()
    assert (np.abs(judged[AT:] - right[AT:])[:, :, 0] < 2.0 * NEAR).all()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("scales", [(0.12, -1.0), (0.12, 2.6), (-1.0, -1.0)])
def test_the_acceleration_of_an_amplifier_that_fails_stays_known(scales, axis):
    samples, right, flow = motion()
    samples[AT:, [A, F], axis] *= scales
    judged, replaced, _ = judged_of(samples, flow)
    assert replaced[AT : AT + REVISED, [A, F], axis].all()
    off = judged[AT + 1 : AT + 7, A, axis] - right[AT + 1 : AT + 7, A, axis]
    assert np.abs(off).max() < NEAR[A]


@pytest.mark.parametrize("row", range(4))
@pytest.mark.parametrize("step", [0, 1, 2])
def test_the_first_samples_are_judged_against_rest(row, step):
    samples, _, flow = motion()
    faulty = samples.copy()
    faulty[step, row, 1] = 0.5 * WIDE[row, 1]
    judged, replaced, _ = judged_of(faulty, flow)
    assert replaced.sum() == replaced[step, row, 1] == 1
    assert abs(judged[step, row, 1]) < NEAR[row]


def derived(samples, derivation):
    """Give samples of a rig without a sensor of the velocity."""
    samples = samples.copy()
    for k in range(len(samples)):
        derive_velocity(derivation, k, samples[k - 1], samples[k])
    return samples


DERIVATIONS = [Derivation(1.0 / DT, 0.0), Derivation(0.7 / DT, 0.3)]


@pytest.mark.parametrize("derivation", DERIVATIONS)
def test_a_derived_velocity_has_the_noise_of_its_displacement(derivation):
    noise = NOISE * np.random.default_rng(1).normal(size=(4000, 4, N))
    samples, off = derived(noise, derivation), []
    p, state = fresh_judge(derivation=derivation)
    for k, sample in enumerate(samples):
        judge(p, state, k, sample, np.zeros((2, N)), np.empty((4, N)))
        off.append(state.room[0].off[:2].copy())
    expected = state.axes[-1].blur[:2, :2]
    np.testing.assert_allclose(
        np.cov(np.transpose(off[10:]))[np.tril_indices(2)], expected[np.tril_indices(2)], rtol=0.1
    )


@pytest.mark.parametrize("derivation", DERIVATIONS)
@pytest.mark.parametrize("value", [3e-2, math.nan])
def test_a_wrong_displacement_is_one_wrong_value_though_the_velocity_is_derived(derivation, value):
    samples, _, flow = motion()
    right = derived(samples, derivation)
    samples[AT, X] = value
    judged, replaced, _ = judged_of(derived(samples, derivation), flow, derivation=derivation)
    expected = np.zeros_like(replaced)
    expected[AT, X] = 1
    np.testing.assert_array_equal(replaced, expected)
    after = AT + np.arange(20)
    np.testing.assert_allclose(judged[after, V], right[after, V], atol=6.0 * NOISE[0].max() / DT)


def test_a_rig_of_which_the_rest_is_not_known_is_believed():
    samples, _, flow = motion()
    samples[:, F, 1] += 1500.0  # a static load
    unknown = np.array([0.0 * WIDE, 0.1 * WIDE])
    flow[:, 1] += OIL[1, 1] * 1500.0 / OIL[1, 0]
    assert not judged_of(samples, flow, rest=unknown)[1].any()
    assert judged_of(samples, flow)[1][0, F, 1]


def test_a_wrong_value_that_was_accepted_is_repaired_and_a_sound_one_taken_back():
    """The acceleration jumps just before a sample; the velocity shows only later that it did."""
    samples, _, flow = motion()
    jump = 25.0
    late = samples.copy()
    for k in range(AT, LENGTH):
        steps = k - AT + 0.02
        late[k, A, 0] += jump
        late[k, V, 0] += jump * steps * DT
        late[k, X, 0] += 0.5 * jump * (steps * DT) ** 2
        flow[k, 0] += jump * max(steps - 0.5, 0.0) * DT
    judged, replaced, state = judged_of(late[: AT + 8], flow)
    assert set(np.flatnonzero(replaced[:, A, 0])) <= {AT, AT + 1}
    np.testing.assert_array_equal(judged[AT + REVISED :], late[AT + REVISED : AT + 8])
    assert (state.axes[0].alive[0].wrong[:3] & 15).tolist() == [0, 0, 0]
    assert not state.counts.any() and not (state.sets & 15).any()


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
        assert state.judge.counts[row, axis] == (3 if ends else 0)
        code = (rows.WRONG + row) * N + axis
        assert (found[-1] == code) == ends
        assert (len(found) == AT + 2 * apart + 1) == ends


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
    _, replaced, state = judged_of(samples, flow)
    for axis in range(N):
        assert not replaced[:, [X, V, F], axis].any()
        assert set(np.flatnonzero(replaced[:, A, axis])) <= {AT, AT + 10, AT + 11}
    assert state.axes[0].known > 1000.0


def test_a_force_that_turns_as_was_asked_is_not_wrong_though_the_specimen_sticks():
    samples, asked = np.zeros((LENGTH, 4, N)), np.zeros((LENGTH, N))
    for first, change in ((100, 200.0), (104, -500.0), (108, 700.0)):
        asked[first:, 1] += change
    samples[5:, F] = asked[:-5]  # the delay of the rig
    flow = np.zeros((LENGTH, N))
    judged, replaced, _ = judged_of(samples, flow, oil=0.0 * OIL, asked=asked)
    assert not replaced.any()
    np.testing.assert_array_equal(judged, samples)


def branch_of(restoring, blur, value=(0.0, 0.0, 0.0, 0.0)):
    """A history with r and its variance at the last two samples, and the last value."""
    b = np.zeros(1, BRANCH).view(np.recarray)[0]
    b.restoring[:], b.blur[:], b.value[0] = restoring, blur, value
    b.variance[0] = NOISE[:, 0] ** 2
    return b


@pytest.mark.parametrize(
    ("change", "rises", "part", "left"),
    [
        (0.0, 0.0, 0.0, 100.0),  # it stands still
        (1000.0, 0.0, 1.0, 500.0),  # it changes more than its noise
        (0.0, 1e6, 1.0, 500.0),  # it has changed as much in the last samples
    ],
)
def test_the_specimens_force_goes_on_by_what_is_known_of_its_change(change, rises, part, left):
    p, state = fresh_judge(mass=np.diag([60.0, 40.0]))
    state.axes[0].rises = rises
    b = branch_of((500.0 + change, 500.0), (100.0, 100.0))
    expected, variance = go_on(p.axes[0], state.axes[0], b)
    assert expected == pytest.approx(500.0 + (1.0 + part) * change, rel=1e-3)
    assert variance == pytest.approx(left, rel=1e-2)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_specimen_that_moves_on_loses_force_only_where_it_breaks(sign):
    p, state = fresh_judge()
    room, known, axis = state.room[0], p.axes[0], state.axes[0]
    b = branch_of((sign * 540.0, sign * 500.0), (9.0, 9.0))
    room.noise[:] = NOISE[:, 0] ** 2

    def chance_of(change):
        room.seen[F], room.seen[A] = sign * (540.0 + change), 0.0
        return log_opposed(known, axis, room, b, 0)

    room.most[:] = (np.inf, 20.0) if sign > 0.0 else (20.0, np.inf)
    assert chance_of(-200.0) == BREAKS
    assert chance_of(-20.0) == pytest.approx(math.log(0.5), rel=1e-6)  # it softens
    assert chance_of(200.0) == 0.0  # it hits a stop
    room.which[0] = 0b1000
    room.amplitude[0, F] = -sign * 200.0
    assert chance_of(-200.0) > -0.1  # the force is wrong
    room.most[:] = np.inf
    room.which[0] = 0
    assert chance_of(-200.0) == 0.0  # friction turns


def opposed_by(last, now):
    """Largest rise and fall of r of the first axis, by velocities of both axes."""
    p, state = fresh_judge()
    raw = np.zeros((4, N))
    for i in range(N):
        state.axes[i].alive[0].value[0, V], raw[V, i] = last[i], now[i]
    oppose(p, state, 0, raw)
    return state.room[0].most.copy()


def test_the_force_may_fall_by_what_springs_and_dampers_make():
    ground, between = STIFFNESS[0].sum(), -STIFFNESS[0, 1]
    assert (opposed_by((0.1, 0.0), (-0.1, 0.0)) == np.inf).all()  # it turns
    assert (opposed_by((0.1, 0.1), (0.1, 0.1)) == np.inf).all()  # between both axes nothing moves
    rise, fall = opposed_by((0.1, 0.0), (0.2, 0.0))  # both springs are strained further
    damped = 0.5 * (math.sqrt(ground * MASS[0, 0]) + math.sqrt(between * MASS[0, 0])) * 0.1
    assert rise == np.inf
    assert fall == pytest.approx(0.5 * (ground + between) * 0.15 * DT + damped)
    rise, fall = opposed_by((0.1, 0.3), (0.1, 0.3))  # that between them lets go
    on, back = ground * 0.1 * DT, between * 0.2 * DT
    assert (rise, fall) == pytest.approx((2.0 * on + 0.5 * back, 2.0 * back + 0.5 * on))


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_value_at_its_end_is_beyond_it_if_the_others_say_so_and_else_wrong(sign):
    samples, right, flow = motion()
    ranges = WIDE.copy()
    ranges[A] = 0.8 * np.abs(samples[:, A]).max()
    clipped = samples.copy()
    clipped[:, A] = np.clip(clipped[:, A], -ranges[A], ranges[A])
    judged, replaced, _ = judged_of(clipped, flow, ranges=ranges)
    assert not replaced.any()
    at_end = np.abs(samples[:, A]) >= ranges[A]
    assert at_end.any()
    off = np.abs(judged - right)
    assert (off[:, A][at_end] < 2.0 * NEAR[A]).all()
    clipped[AT, A, 1] = sign * ranges[A, 1]
    for after in range(3):
        wrong = clipped.copy()
        wrong[AT + after, F, 1] += 800.0
        judged, replaced, _ = judged_of(wrong, flow, ranges=ranges)
        assert replaced[AT + after, F, 1]
        assert replaced[AT, A, 1] == (sign > 0.0)  # it is there, but for a little
        assert (np.abs(judged - right)[AT : AT + 4, F, 1] < 2.0 * NEAR[F]).all()


@pytest.mark.parametrize("end", [1.0, -1.0])
def test_a_force_that_jumps_to_its_range_s_end_behind_a_servo_is_wrong(end):
    samples, _, flow = motion()
    samples[AT:, F, 1] = end * WIDE[F, 1]
    _, replaced, _ = judged_of(samples[: AT + 6], flow, imposed=1, oil=0.0 * OIL)
    assert replaced[AT:, F, 1].all()


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
        *((row, NOTHING, OIL) for row in (X, V)),
        *((row, MASS, 0.0 * OIL) for row in (X, V, A, F)),
        *((row, NOTHING, 0.0 * OIL) for row in (X, V)),
    ],
)
def test_with_less_known_spikes_are_found_where_the_equations_allow(row, mass, oil):
    samples, right, flow = motion()
    for sign in (1.0, -1.0):
        faulty = samples.copy()
        faulty[AT, row, 1] += sign * LARGEST[row, 1]
        judged, replaced, _ = judged_of(faulty, flow, mass=mass, oil=oil)
        assert replaced[AT, row, 1]
        assert abs(judged[AT, row, 1] - right[AT, row, 1]) < 0.1 * LARGEST[row, 1]


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
@pytest.mark.parametrize("row", range(4))
def test_a_first_value_that_is_no_number_is_that_of_rest(row, value):
    samples, _, flow = motion()
    samples[0, row, 1] = value
    judged, replaced, _ = judged_of(samples[:1], flow)
    assert replaced.sum() == replaced[0, row, 1] == 1
    assert abs(judged[0, row, 1]) < NEAR[row]


def test_what_rounding_leaves_of_unknowns_is_no_certainty():
    """All channels wrong, without a range of any: the last one has no information but rounding."""
    root, third = np.zeros((2, 2)), 1.0 / 3.0
    det = factorise(1e10 * np.array([[third, third], [third, third]]), root, 2)
    assert det > 0.0
    assert root[1, 1] < 1e3


def test_nothing_accepted_widens_a_variance_for_long():
    samples, _, flow = motion()
    faulty = samples.copy()
    for at in range(60, LENGTH - 60, 50):  # each 100 ms, as large as is just accepted, and larger
        faulty[at, A, 1] += 0.5 * LARGEST[A, 1]
    for at in range(60, LENGTH - 60, 50):
        _, _, state = judged_of(faulty[: at + 1 + REVISED], flow)
        assert state.sets[at % len(state.sets), 1] == 1 << A
    assert state.axes[1].known == 0.0
