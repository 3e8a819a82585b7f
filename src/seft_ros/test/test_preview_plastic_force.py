"""Forces of a yielding specimen: its tangent, its coming force, and what errors did to it."""

import numpy as np
import pytest
from seft_plant_sim.computed_substructure import ComputedSubstructure
from seft_plant_sim.spring_laws import MEMORY, spring_force
from seft_ros.reference_force.compensation.compensator import Knowledge
from seft_ros.reference_force.compensation.preview.force_error import ForceErrorCorrection
from seft_ros.reference_force.compensation.preview.plastic_force import PlasticForce
from seft_ros.reference_force.compensation.preview.tangent_filter import TangentFilter
from seft_ros.reference_force.compensation.preview.target_prediction import TargetPrediction
from springs_at_hand import spring as made

DT, HORIZON = 0.002, 37
M, C, K, YIELD, NOISE = 52.7, 800.3, 2.11e5, 0.004, 16.0
SPRINGS = [made("bilinear"), made("bouc_wen")]  # K, YIELD, hardening ratio 0.1


def plastic_part(spring, x):
    """p along a path of displacements."""
    return spring.follow(x)[0] - K * x


def knowledge(alpha=1.0, n=1):
    one = np.eye(n)
    return Knowledge(
        M * one, ComputedSubstructure.lumped(alpha * M * one), C * one, K * one, DT, {}
    )


def motion(steps=4000, amplitude=0.01):
    """Smooth motion of many turns, (x, v), shape (steps, 2)."""
    t = DT * np.arange(steps)
    grow = np.minimum(1.0, t / 2.0)
    x = amplitude * grow * (np.sin(9.0 * t) + 0.5 * np.sin(14.3 * t + 1.0)) / 1.5
    return np.column_stack([x, np.gradient(x, DT)])


def response(spring, alpha, steps=4000):
    """Whole structure with this spring: ground motion, (x, v), p = r - K x - C v."""
    rng = np.random.default_rng(7)
    t, inner = DT * np.arange(steps + HORIZON), 10
    hz, phase = rng.uniform(1.0, 7.0, 25), rng.uniform(0, 2 * np.pi, 25)
    a_g = np.minimum(1.0, t / 2) * np.sin(2 * np.pi * hz * t[:, None] + phase).sum(axis=1)
    a_g *= 14.0 / np.abs(a_g).max()
    x = v = s = 0.0
    h, path = DT / inner, []
    law, memory = np.array([spring.law]), np.zeros((1, MEMORY))
    for k in range(steps):
        r = s + C * v
        path.append([x, v, r - K * x - C * v])
        for i in range(inner):  # velocity Verlet
            ground = a_g[k] + (i + 0.5) / inner * (a_g[k + 1] - a_g[k])
            a = -ground - (s + C * v) / (M * (1 + alpha))
            x += h * (v + h * a / 2)
            s = spring_force(law, 0, memory, x)
            ahead = -ground - (s + C * (v + h * a)) / (M * (1 + alpha))
            v += h * (a + ahead) / 2
    path = np.array(path)
    return a_g[:, None], path[:, :2], path[:, 2]


def follower(alpha=1.0, n=1, deformation=None):
    """Of springs that deform as the axes are displaced, or as a matrix says."""
    known, between = knowledge(alpha, n), np.eye(n) if deformation is None else deformation
    stiffness = K * between.T @ between
    restoring = np.hstack([stiffness, known.damping])
    prediction = TargetPrediction(known, np.zeros((1, 1 + HORIZON)), None, restoring)
    gains = prediction.displacements()
    return PlasticForce(stiffness, NOISE * np.eye(n), gains, between), np.zeros(n)


@pytest.mark.parametrize("spring", SPRINGS)
def test_the_tangent_is_that_of_the_spring(spring):
    """Away from knees and turns, where a step tells it from noise."""
    path, rng = motion(), np.random.default_rng(1)
    p = plastic_part(spring, path[:, 0])
    plastic, rest = follower()
    slopes = []
    for y, exact in zip(path, p, strict=True):
        plastic.update(y, rest, exact + rng.normal(0, np.sqrt(NOISE), 1))
        slopes.append(plastic.slope[0, 0])
    exact = np.gradient(p, DT) / np.gradient(path[:, 0], DT)
    steady = np.convolve(np.abs(np.gradient(exact)) < 0.02 * K, np.ones(25) / 25, "same") > 0.99
    steady &= (np.abs(path[:, 1]) > 0.03) & (np.arange(len(p)) > 500)
    assert steady.sum() > 300
    assert np.sqrt(np.mean((np.array(slopes) - exact)[steady] ** 2)) < 0.12 * K


@pytest.mark.parametrize("spring", SPRINGS)
def test_its_force_is_freed_of_noise(spring):
    path, rng = motion(), np.random.default_rng(2)
    p = plastic_part(spring, path[:, 0])
    measured = p + rng.normal(0, np.sqrt(NOISE), p.shape)
    plastic, rest = follower()
    errors = []
    for y, r, exact in zip(path, measured, p, strict=True):
        plastic.update(y, rest, np.array([r]))
        errors.append(rest[0] - exact)
    assert np.sqrt(np.mean(np.square(errors))) < 0.9 * np.sqrt(NOISE)
    assert np.abs(errors).max() < 0.02 * np.abs(p).max()


@pytest.mark.parametrize("alpha", [1.0, 3.0])
@pytest.mark.parametrize("spring", SPRINGS)
def test_the_coming_force_is_better_known_than_by_holding_what_is(spring, alpha):
    """Over 20 steps ahead, more than the delay of the paper's loop."""
    a_g, path, p = response(spring, alpha)
    assert np.abs(path[:, 0]).max() > 3 * YIELD
    rng, (plastic, rest) = np.random.default_rng(3), follower(alpha)
    followed, held = [], []
    for k in range(250, len(p) - 1 - HORIZON):
        y = path[k]
        plastic.update(y, rest, p[k] + rng.normal(0, np.sqrt(NOISE), 1))
        coming = plastic.coming(y, rest, a_g[k : k + 1 + HORIZON], np.zeros(1))
        assert coming[0] == pytest.approx(rest[0], abs=1e-6)
        exact = p[k : k + 21]
        followed.append(np.sqrt(np.mean((coming[:21] - exact) ** 2)))
        held.append(np.sqrt(np.mean((p[k] - exact) ** 2)))
    assert np.mean(followed) < 0.6 * np.mean(held)


def test_springs_between_axes_are_followed_each_by_itself():
    """One storey of two yields: the other's stiffness stays in the tangent."""
    between, path, rng = np.array([[1.0, 0.0], [-1.0, 1.0]]), motion(), np.random.default_rng(2)
    upper = plastic_part(SPRINGS[0], path[:, 0])  # the lower storey hardly moves
    plastic, rest = follower(n=2, deformation=between)
    softest, errors = np.zeros(2), []
    for (e, rate), s in zip(path, upper, strict=True):
        x, v = (np.linalg.solve(between, [0.1 * value, value]) for value in (e, rate))
        p = between.T @ [0.0, s]
        plastic.update(np.concatenate([x, v]), rest, p + rng.normal(0, np.sqrt(NOISE), 2))
        errors.append(rest - p)
        of_springs = np.linalg.solve(between.T, plastic.slope) @ np.linalg.inv(between)
        np.testing.assert_allclose(of_springs, np.diag(of_springs.diagonal()), atol=1e-6 * K)
        softest = np.minimum(softest, of_springs.diagonal())
    assert softest[1] < -0.8 * K
    assert softest[0] > -0.4 * K
    assert np.sqrt(np.mean(np.square(errors))) < 2 * np.sqrt(NOISE)


def test_an_elastic_specimen_is_expected_to_stay_so():
    path, rng = motion(), np.random.default_rng(4)
    plastic, rest = follower()
    slopes = []
    for y in path:
        plastic.update(y, rest, rng.normal(0, np.sqrt(NOISE), 1))
        assert abs(rest[0]) < 5 * np.sqrt(NOISE)
        slopes.append(plastic.slope[0, 0])
    assert np.sqrt(np.mean(np.square(slopes))) < 0.1 * K


def test_axes_are_followed_on_their_own():
    paths = np.stack([motion(600), motion(600, 0.006)], axis=2)
    p = [plastic_part(spring, x) for spring, x in zip(SPRINGS, paths[:, 0].T, strict=True)]
    (both, rest), singles = follower(n=2), [follower() for _ in range(2)]
    a_g = np.random.default_rng(5).normal(0, 2.0, (1 + HORIZON, 2))
    for k, y in enumerate(paths):
        both.update(y.ravel(), rest, np.array([p[0][k], p[1][k]]))
        found = both.coming(y.ravel(), rest, a_g, np.zeros(2)).reshape(-1, 2)
        for axis, (one, own) in enumerate(singles):
            column = slice(axis, axis + 1)
            one.update(y[:, axis], own, p[axis][k : k + 1])
            np.testing.assert_allclose(rest[axis], own[0], rtol=1e-12, atol=1e-12)
            alone = one.coming(y[:, axis], own, a_g[:, column], np.zeros(1))
            np.testing.assert_allclose(found[:, axis], alone, rtol=1e-9, atol=1e-7)


def correction(known, factor=1.0):
    return ForceErrorCorrection(known, factor * np.hstack([known.stiffness, known.damping]))


def run_correction(known, slope, error, steps):
    """Forces by which a lasting force error is answered, shape (steps, n)."""
    n, one = known.axes, correction(known)
    zero, still = np.zeros(n), np.zeros(2 * n)
    return np.array([one.step(zero, error, still, zero, slope, zero).copy() for _ in range(steps)])


@pytest.mark.parametrize("alpha", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("stiffness", [0.0, 0.1 * K])
def test_a_lasting_force_error_is_answered_as_its_equations_say(alpha, stiffness):
    """Exact deviation of the damped oscillator under a constant force, and its integral."""
    known, error = knowledge(alpha), 2.0
    slope = np.array([[stiffness - K]])
    times = DT * np.arange(1, 401)
    total, force = M * (1 + alpha), (1 + alpha) * error
    roots = np.roots([total, C, stiffness]).astype(complex)
    if stiffness:
        # d = force / K_t (1 + (r2 e^{r1 t} - r1 e^{r2 t}) / (r1 - r2))
        r1, r2 = roots
        e1, e2 = np.exp(r1 * times), np.exp(r2 * times)
        d = (force / stiffness * (1 + (r2 * e1 - r1 * e2) / (r1 - r2))).real
        rate = (force / stiffness * r1 * r2 * (e1 - e2) / (r1 - r2)).real
    else:
        fade = np.exp(-C / total * times)
        rate = force / C * (1 - fade)
        d = force / C * (times - total / C * (1 - fade))
    w = 2 * np.pi * 4.0
    exact = M * (w * w * d + 2 * w * rate)
    found = run_correction(known, slope, np.array([error]), 400)[:, 0]
    # integral of w e, within a tenth of the largest restoring force so far: none
    np.testing.assert_allclose(found, exact, atol=0.02 * np.abs(exact).max())


def test_the_integral_of_the_error_ends_at_a_tenth_of_the_restoring_force():
    one = correction(knowledge(1.0), 10.0)  # stiff: the specimen hardly deviates
    share, error, pull = 0.5, 5.0, np.array([200.0])
    zero, still, flat = np.zeros(1), np.zeros(2), np.zeros((1, 1))
    answers = [one.step(zero, share * pull + error, still, pull, flat, zero)[0] for _ in range(500)]
    assert answers[20] == pytest.approx(21 * 2 * np.pi * 4.0 * DT * error, abs=0.5)
    assert answers[-1] == pytest.approx(0.1 * pull[0], abs=0.5)


def test_a_way_back_that_is_told_is_all_that_a_force_error_is_answered_with():
    """The forces that a way back of the usual gain asks for, and no integral."""
    known, error = knowledge(1.0), np.array([5.0])
    w, restoring = 2 * np.pi * 4.0, np.hstack([10 * known.stiffness, known.damping])
    told = ForceErrorCorrection(known, restoring, way_back=M * np.array([[w * w, 2 * w]]))
    usual = ForceErrorCorrection(known, restoring)
    zero, still, flat = np.zeros(1), np.zeros(2), np.zeros((1, 1))
    for _ in range(100):  # nothing pulls: the integral of the other ends at nothing
        answers = [one.step(zero, error, still, zero, flat, zero)[0] for one in (told, usual)]
        np.testing.assert_allclose(*answers, atol=0.1 * error[0])
    pull = np.array([200.0])
    share = told.step(zero, 0.5 * pull + error, still, pull, flat, zero)[0]
    assert abs(share) < 0.05 * pull[0]


def test_a_deviation_of_the_loop_is_followed_where_it_lasts():
    one, zero = correction(knowledge(1.0, n=2)), np.zeros(2)
    answers = [
        one.step(zero, zero, np.zeros(4), zero, np.zeros((2, 2)), np.array([7.0, -3.0])).copy()
        for _ in range(200)
    ]
    exact = 1.0 - np.exp(-2 * np.pi * 6.0 * DT * np.arange(1, 201))
    np.testing.assert_allclose(answers, np.outer(exact, [7.0, -3.0]), rtol=1e-9)


def test_without_force_errors_nothing_is_mended():
    rng, known = np.random.default_rng(6), knowledge(3.0, n=2)
    one = correction(known)
    restoring, share = np.hstack([known.stiffness, known.damping]), 0.75
    for _ in range(50):
        a_g, rest, slopes = rng.normal(size=(3, 2)) * [[1.0], [300.0], [K]]
        motion = rng.normal(size=4) * 1e-3
        force = -M * a_g + share * (restoring @ motion + rest)
        mended = one.step(a_g, force, motion, rest, np.diag(slopes), np.zeros(2))
        np.testing.assert_allclose(mended, 0.0, atol=1e-8)


def test_a_spring_that_vibrates_while_it_yields_is_not_taken_for_elastic():
    """Small turns back, and its slope is known at once when it loads again."""
    spring = SPRINGS[1]
    t = DT * np.arange(1200)
    x = 0.012 * t / t[-1] + 1.2e-4 * np.sin(2 * np.pi * 30.0 * t)
    v, p = np.gradient(x, DT), plastic_part(spring, x)
    tangent = np.gradient(p) / np.gradient(x) / K
    one, rng = TangentFilter(K, NOISE), np.random.default_rng(4)
    followed, error = p[0], []
    for k in range(len(t)):
        followed = one.step(x[k], v[k], followed, p[k] + rng.normal(0, np.sqrt(NOISE)))
        if k > 600 and v[k] > 0.0 >= v[k - 3]:  # up to its third step since a turn
            error.append(one.slope / K - tangent[k])
    assert len(error) > 50
    assert np.sqrt(np.mean(np.square(error))) < 0.4
