"""The target against exact solutions, and what it makes of what is known wrongly."""

import numpy as np
import pytest
from experiments_at_hand import load, simulated
from seft_plant_sim.rig_parameters import truth
from seft_plant_sim.whole_structure import reference_response
from seft_ros.analysis.metrics import nrmse
from seft_ros.reference_force import restoring_model as models
from seft_ros.reference_force.observers import observe, observer_gains
from seft_ros.reference_force.reference_force_block import method_inputs
from seft_ros.reference_force.stop_operators import stop_operators
from seft_ros.reference_force.target_motion import TargetMotion, spring_deformations
from seft_ros.test_run.blocks import build_blocks

METHOD = (
    "reference_force:compensation.method:=target_motion",
    "force_controller:method:=velocity_feedforward",
    "reference_force:mass_ratio:=1.0",
    "ground_motion:peak_force:=500.0",
)
K = 2.11e5


def experiment(*words, config="jhu"):
    return load(*METHOD, *words, config=config)


def error(*words, config="jhu"):
    """Displacement NRMSE of a simulated test, %."""
    tested = experiment(*words, config=config)
    recording = simulated(tested)
    assert recording.trip is None
    measured, motion = recording.measured.values, recording.series["ground_motion"].values
    exact = reference_response(tested, motion[:, 0])
    return 100 * nrmse(measured[:, 0], exact.displacement)


def target(*words, config="jhu"):
    tested = experiment(*words, config=config)
    known = method_inputs(tested["reference_force"], tested.axes, tested.timebase)
    return tested, TargetMotion(known)


def motion_of(tested):
    return build_blocks(tested).ground_motion


# ---- the target


@pytest.mark.parametrize("config", ["jhu", "three_storey_frame", "water_tower"])
def test_exact_test_is_its_own_target(config):
    tested, method = target("ground_motion:synthetic.duration:=8.0", config=config)
    ground = motion_of(tested)
    exact = reference_response(tested, ground.samples)
    window = 1 + method.preview
    steps = enumerate(exact.states)
    points = np.array([method.step(ground.known[k : k + window], one)[0] for k, one in steps])
    assert nrmse(points[:, 0], exact.displacement) < 2e-4
    assert nrmse(points[:, 2], exact.force) < 2e-3


def test_force_of_every_point_is_equation_2_5_with_the_targets_acceleration():
    tested, method = target()
    ground = np.full((1 + method.preview, 1), 1.5)
    rng = np.random.default_rng(1)
    state = np.array([[1e-3], [0.05], [2.0], [150.0]])
    points = method.step(ground, state + 1e-3 * rng.standard_normal((4, 1)))
    m, dt = 52.7, tested.timebase.dt
    acceleration = np.gradient(points[:, 1, 0], dt)[2:-2]
    force = -2 * m * ground[2:-2, 0] - m * acceleration
    assert points[2:-2, 2, 0] == pytest.approx(force, abs=0.02 * np.abs(force).max())


STOREYS = np.array([[1.0, 0.0, 0.0], [-1.0, 1.0, 0.0], [0.0, -1.0, 1.0]])


@pytest.mark.parametrize("told", [True, False])
def test_a_stiffness_that_was_identified_keeps_the_springs_that_were_told(told):
    off = np.array([[300.0, 150.0, -80.0], [150.0, -200.0, 60.0], [-80.0, 60.0, 250.0]])  # N/m
    stiffness = STOREYS.T @ STOREYS * 2e5 + off
    words = [f"specimen.stiffness:={stiffness.ravel().tolist()}"]
    words += [f"specimen.springs:={STOREYS.ravel().tolist()}"] if told else []
    tested = load(*words, config="three_storey_frame")
    known = method_inputs(tested["reference_force"], tested.axes, tested.timebase)
    found = spring_deformations(known)
    if told:
        np.testing.assert_array_equal(found, STOREYS)
    else:  # its modes: they are coupled by neither mass nor stiffness
        modes = np.linalg.inv(found)
        own = modes.T @ stiffness @ modes
        np.testing.assert_allclose(own, np.diag(np.diag(own)), atol=1e-6 * own.max())


def test_target_starts_where_the_specimen_is():
    _, method = target()
    state = np.array([[2e-3], [0.0], [0.0], [K * 2e-3]])
    points = method.step(np.zeros((1 + method.preview, 1)), state)
    assert points[0, 0, 0] == 2e-3


def test_stop_operators_turn_where_the_specimen_does_between_its_samples():
    _, compensation = target("rate:=250.0")
    fine = np.arange(0.0, 0.6, 2e-5)
    y = compensation.state.model.thresholds[0, 8]
    x, v = 5.0 * y * np.sin(37.0 * fine), 185.0 * y * np.cos(37.0 * fine)
    stops = stop_operators(x, np.array([y]))[:, 0]
    off = []
    for k in range(0, len(fine), 200):
        sample = np.array([[x[k]], [v[k]], [-(37.0**2) * x[k]], [0.0]])
        compensation.step(np.zeros((1 + compensation.preview, 1)), sample)
        off.append(compensation.state.model.stops[0, 8] - stops[k])
    assert np.abs(off).max() < 0.01 * y


def test_target_comes_to_rest_as_its_pace_goes_to_zero():
    tested, method = target()
    ground = motion_of(tested).known
    states = reference_response(tested, motion_of(tested).samples).states
    window, begin = 1 + method.preview, 2000
    points = np.zeros((window, 3, 1))
    for k in range(begin + 1000):
        if k < begin:
            measured = states[k]
        else:  # the specimen follows the target
            a = (points[1, 2] - 800.3 * points[1, 1] - K * points[1, 0]) / 52.7
            measured = np.array([points[1, 0], points[1, 1], a, points[1, 2]])
            method.progress = max(0.0, 1.0 - (k - begin) / 250)
        points = method.step(ground[k : k + window], measured)
    assert abs(points[0, 1, 0]) < 1e-4
    assert abs(points[0, 2, 0]) < 1.0


# ---- the observer


def test_observer_has_less_noise_than_the_sensors_and_no_lag():
    dt, n = 0.002, 4000
    noise = np.array([[5e-6], [1e-3], [0.05], [3.0]])
    gains, left = observer_gains(noise, dt)
    t = dt * np.arange(n)
    w = 2 * np.pi * 7
    true = 0.003 * np.array([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])
    rng = np.random.default_rng(3)
    motion, seen = np.zeros((3, 1)), np.empty((2, n))
    for k in range(n):
        measured = np.zeros((4, 1))
        measured[:3, 0] = true[:, k] + noise[:3, 0] * rng.standard_normal(3)
        observe(gains, dt, k == 0, measured, motion)
        seen[:, k] = motion[:2, 0]
    wrong = (seen - true[:2])[:, 100:]
    assert wrong.std(axis=1) == pytest.approx(left[:, 0], rel=0.3)
    assert wrong[0].std() < 0.7 * noise[0, 0]
    assert abs(wrong @ true[1, 100:] / (true[1] @ true[1]))[0] < 5e-6  # s


# ---- the model of the restoring force


def followed(restoring, x, v, stiffness=K, damping=800.0, noise=4.0, seed=1):
    """Follow a measured restoring force; give state and errors of the values in use.

    The second row of the errors is with what makes good for the impulses before.
    """
    dt = 0.002
    of_spring = (np.array([[value]]) for value in (52.7, damping, stiffness))
    noises = np.array([noise]), np.array([[2.6e-6, 4.5e-4]]), 1.0
    made = models.model_arrays((0,), *of_spring, *noises, np.array([44.7]), dt)
    parameters, state = made
    models.begin_model(parameters, state)
    rng, last = np.random.default_rng(seed), 0.0
    left = []
    for one, rate, r in zip(x, v, restoring, strict=True):
        models.move_stops(parameters, state.thresholds, np.array([one - last]), state.stops)
        last = one
        measured = np.array([r + noise * rng.standard_normal()])
        models.follow_specimen(parameters, state, np.array([one]), np.array([rate]), measured)
        error = r - state.values[0] @ state.regressors[0]
        left.append((error, error - state.sums[0].correction))
    return parameters, state, np.transpose(left)


def test_later_samples_mend_the_impulse_before_them():
    """A kinked line and noise: running estimates alone add up to more noise than was measured."""
    x = np.concatenate([np.linspace(0.0, 0.004, 100), np.linspace(0.004, 0.008, 60)])
    v = np.full(160, 0.02)
    path = np.minimum(K * x, 0.004 * K) + 800 * v
    off = []
    for seed in range(200):
        _, _, left = followed(path, x, v, seed=seed)
        off.append(left[:, 100:].sum(axis=1))
    alone, mended = np.sqrt(np.mean(np.square(off), axis=0))
    assert mended < 0.75 * alone


def test_what_hardly_moves_tells_of_the_offset_alone():
    rng = np.random.default_rng(4)
    x, v = 1e-6 * rng.standard_normal(4000), np.zeros(4000)
    _, state, _ = followed(30.0 + K * x, x, v)
    assert state.found[0, 1] == K
    assert state.values[0, 0] == pytest.approx(30.0, abs=2.0)


@pytest.mark.parametrize("share", [0.9, 1.1])
def test_an_offset_that_is_less_certain_than_the_sum_does_not_overshoot(share):
    """At rest far from the origin an offset and the stiffness are known together only."""
    x = np.array([0.005, 0.00498, 0.00498])
    parameters, state, _ = followed(K * x, x, 0.0 * x)
    state.covariance[0] = 0.0
    state.covariance[0, :2, :2] = 50.0**2 * np.outer(*2 * [[1.0, -share / x[2]]])
    expected = state.found[0] @ state.regressors[0]
    models.follow_specimen(parameters, state, x[2:], np.zeros(1), np.array([expected + 10.0]))
    assert 0.0 <= abs(state.found[0] @ state.regressors[0] - expected) < 10.0


def test_a_spring_gives_no_energy():
    t = 0.002 * np.arange(1500)
    x, v = 0.004 * np.sin(30.0 * t), 0.12 * np.cos(30.0 * t)
    _, state, left = followed(K * x - 900.0 * v, x, v, damping=100.0)
    assert 0.0 <= state.found[0, 2] < 100.0
    assert np.abs(left[0, -500:]).max() < 30.0  # the offset takes what it would have given


def test_noise_at_rest_does_not_soften_what_sticks():
    """After slips of 2 mm it sticks for 16 s, while the displacement has noise."""
    t, sticks, rng = 0.002 * np.arange(9000), 9.5e6, np.random.default_rng(5)
    true = 0.002 * np.sin(40.0 * np.minimum(t, 1.9)) + 1e-6 * np.sin(60.0 * t)
    v, stops = np.gradient(true, 0.002), stop_operators(true, np.array([2e-5]))
    x, rate = (of + rng.normal(0.0, noise, 9000) for of, noise in ((true, 2.6e-6), (v, 4.5e-4)))
    parameters, state, _ = followed(K * true + 800.0 * v + sticks * stops[:, 0], x, rate)
    state.stops[0] = 0.0
    assert state.found[0, 1:3] == pytest.approx([K, 800.0], rel=0.2)
    assert models.tangent(parameters, state, 0) > 0.4 * sticks


# ---- the whole loop

LAWS: dict[str, tuple[tuple[str, ...], float]] = {
    "linear": ((), 0.6),
    "Bouc-Wen": (("kind:=bouc_wen", "yield_displacement:=0.003"), 1.2),
    "bilinear": (("kind:=bilinear", "yield_displacement:=0.004", "hardening_ratio:=0.1"), 1.6),
    "hardening": (("kind:=duffing", f"duffing.cubic:={0.1 * K / 0.005**2}"), 1.2),
    "softening": (("kind:=duffing", f"duffing.cubic:={-0.1 * K / 0.008**2}"), 1.2),
    "gap": (("kind:=gap", "gap.width:=0.004", f"gap.stiffness:={2 * K}"), 1.2),
    "flag": (("kind:=flag", "yield_displacement:=0.003", "flag.dissipation:=0.7"), 1.4),
    "pinching": (("kind:=pinching", "yield_displacement:=0.003"), 1.4),
    "friction 20 N": (("kind:=friction", "friction.force:=20.0"), 1.5),
    "friction 60 N": (("kind:=friction", "friction.force:=60.0"), 1.5),
    "friction 190 N": (("kind:=friction", "friction.force:=190.0"), 6.0),
}


@pytest.mark.parametrize("law", LAWS)
def test_test_is_right_whatever_the_specimen_does(law):
    words, most = LAWS[law]
    assert error(*(f"rig:simulated.specimen.{word}" for word in words)) < most


def test_storeys_that_yield_keep_their_impulses():
    """Their laws are learnt from few slips, and later samples correct what they were wrong by."""
    words = "kind:=bilinear", "yield_displacement:=0.003"
    frame = "specimen.springs:=[1.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, -1.0, 1.0]"
    specimen = (f"rig:simulated.specimen.{word}" for word in words)
    force = "ground_motion:peak_force:=200.0"
    assert error(frame, force, *specimen, config="three_storey_frame") < 0.9


TRUE = [("rig", *item) for item in truth(load()["rig"]).items()]
KNOWN_WRONGLY = {
    "stiffness": "/**:specimen.stiffness:=1.48e5",
    "damping": "/**:specimen.damping:=2400.0",
    "flow gain": "/**:actuator.flow_gain:=0.0363",
    "dead time": "/**:actuator.dead_time:=0.002",
    "oil": "/**:actuator.oil_stiffness:=1.25e7",
    "valve": "/**:actuator.valve_frequency:=91.0",
}


@pytest.mark.parametrize("what", KNOWN_WRONGLY)
def test_what_is_known_wrongly_hardly_matters(what):
    assert error(*TRUE, KNOWN_WRONGLY[what]) < 1.0


@pytest.mark.parametrize(
    ("mass_ratio", "peak", "most"), [(0.5, 450.0, 1.15), (3.0, 250.0, 0.75), (10.0, 120.0, 0.8)]
)
def test_a_wrong_model_costs_no_accuracy_at_any_mass_ratio(mass_ratio, peak, most):
    """The largest forces that the valve serves there, N; of the first, 0.6 % is sensor noise."""
    words = (f"reference_force:mass_ratio:={mass_ratio}", f"ground_motion:peak_force:={peak}")
    wrong = ("/**:specimen.stiffness:=1.69e5", "/**:specimen.damping:=1600.0")
    assert error(*words, *TRUE, *wrong) < most


@pytest.mark.parametrize("rate", [250, 1000])
def test_other_rates(rate):
    assert error(f"rate:={float(rate)}") < 1.0


@pytest.mark.parametrize(
    ("law", "most"),
    [
        ((), 2.0),
        (("kind:=bouc_wen", "yield_displacement:=0.003"), 3.0),
        (("kind:=friction", "friction.force:=20.0"), 3.0),
    ],
)
def test_rig_that_is_driven_by_late_forces(law, most):
    words = ("/**:actuator.kind:=delay", "/**:actuator.delay:=0.01")
    assert error(*words, *(f"rig:simulated.specimen.{word}" for word in law)) < most


@pytest.mark.parametrize(
    ("delay", "rate"), [(0.0, 500.0), (0.0, 2000.0), (0.0005, 500.0), (0.002, 500.0)]
)
def test_a_force_that_acts_within_few_samples_does_not_ring(delay, rate):
    words = f"rate:={rate}", "actuator.kind:=delay", f"actuator.delay:={delay}"
    assert error(*words, "reference_force:instability.ratio:=100.0") < 1.0
