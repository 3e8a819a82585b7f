"""Scale, tilt, lag and filter of the sensors against the exact motion."""

import numpy as np
import pytest
from bare_rig import FRAME, BareRig, driven, make_rig, rig_section, transfer
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import rigs_of
from seft_plant_sim.rig import Rig
from seft_plant_sim.rig_parameters import RIG_TABLE, filter_of
from seft_plant_sim.simulated.continuous_model import delayed_force
from seft_plant_sim.simulated.rig import continuous_model
from seft_plant_sim.simulated.sensors import sensed
from seft_plant_sim.simulated.specimen import Specimen

PAIR = Specimen(
    np.array([[60.0, 5.0], [5.0, 45.0]]),
    np.array([[900.0, -200.0], [-200.0, 700.0]]),
    np.array([[3.0e5, -1.0e5], [-1.0e5, 2.5e5]]),
)
CUTOFF = 80.0
DT = 0.002
X, V, A, F = range(4)


def behind(model, scale=1.0, mix=None, lag=0.0, cutoff=0.0):
    n = model.b.shape[1]
    rows = (np.broadcast_to(value, 4 * n).astype(float) for value in (scale, lag, cutoff))
    scale, lag, cutoff = rows
    filters = np.array(filter_of(cutoff, np.sqrt(0.5)))
    return sensed(model, scale, np.eye(n) if mix is None else np.array(mix), lag, filters)


def butterworth(hz):
    """|H|^2 = 1 / (1 + (w/wc)^4), poles at wc e^(+-3 pi j / 4)."""
    pole = np.exp(0.75j * np.pi)
    s = 1j * hz / CUTOFF
    return 1 / ((s - pole) * (s - pole.conjugate()))


@pytest.mark.parametrize("hz", [0.01, 5.0, 40.0, 80.0, 160.0, 1000.0])
def test_a_filter_has_the_gain_and_phase_of_a_butterworth_low_pass(hz):
    model = delayed_force(PAIR, 0.003)
    filtered = behind(model, cutoff=[CUTOFF] * 6 + [0.0] * 2)
    expected = transfer(model, hz)
    expected[:6] *= butterworth(hz)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(transfer(filtered, hz), expected, rtol=1e-7, atol=1e-12 * scale)
    assert abs(butterworth(hz)) == pytest.approx((1 + (hz / CUTOFF) ** 4) ** -0.5)
    assert filtered.delay.tolist() == [0.003, 0.003]
    assert filtered.drive == model.drive


def test_a_lag_of_whole_samples_is_a_shift_of_bits():
    section = rig_section(specimen__kind="friction", specimen__friction__force=60.0)
    model = continuous_model(section, ("x",))
    commands = np.random.default_rng(1).normal(size=(200, 1))
    rigs = (BareRig(one, DT) for one in (model, behind(model, lag=3 * DT)))
    own, late = (driven(rig, commands)[:, :4] for rig in rigs)
    np.testing.assert_array_equal(late[3:], own[:-3])
    assert not late[:3].any()


@pytest.mark.parametrize("tenths", [2, 7, 23, 57])
@pytest.mark.parametrize("kind", ["servo_hydraulic", "delay"])
def test_a_lag_between_samples_is_the_motion_at_that_time(kind, tenths):
    """Of a rig that is sampled ten times as often."""
    section = rig_section(
        specimen__kind="bilinear",
        specimen__yield_displacement=0.001,
        actuator__kind=kind,
        actuator__delay=0.0033,
        actuator__dead_time=0.0011,
    )
    model = continuous_model(section, ("x",))
    commands = np.random.default_rng(2).normal(size=(300, 1))
    late, fine = BareRig(behind(model, lag=tenths * DT / 10), DT), BareRig(model, DT / 10)
    found = driven(late, commands)[1:, :4]
    # a command acts from the next sample on: here 9 fine samples later
    drives = np.vstack([np.zeros((9, 1)), np.repeat(commands, 10, axis=0)])
    often = driven(fine, drives)[1:, :4]
    at = 10 * np.arange(1, 301) - tenths - 1
    known = at >= 0
    scale = np.abs(often).max(axis=0)
    np.testing.assert_allclose(found[known] / scale, often[at[known]] / scale, atol=2e-3)


def test_scale_and_tilt_act_before_noise_bias_and_converter():
    words = {
        "sensors.force_scale": 1.03,
        "sensors.tilt": [1.0, 0.02, -0.03, 1.0],
        "sensors.acceleration_scale": [1.0, 2.0],
        "sensors.force_bias": 5.0,
    }
    given = {f"specimen.{name}": value for name, value in FRAME.items()} | words
    fault_free = dict.fromkeys(words, 1.0) | {"sensors.force_bias": 0.0, "sensors.tilt": 0.0}
    rigs = (make_rig(("x", "y"), **values) for values in (given, given | fault_free))
    shown, true = (driven(rig, np.tile([1.0, 0.5], (100, 1))) for rig in rigs)
    np.testing.assert_allclose(shown[:, F], 1.03 * true[:, F] + 5.0, rtol=1e-12)
    np.testing.assert_allclose(shown[:, [X, V]], true[:, [X, V]], rtol=1e-12, atol=1e-15)
    tilted = true[:, A] @ np.array([[1.0, 0.02], [-0.03, 1.0]]).T * [1.0, 2.0]
    np.testing.assert_allclose(shown[:, A], tilted, rtol=1e-9, atol=1e-9)


def test_a_derived_velocity_inherits_the_displacements_lag():
    def velocities(**values):
        return driven(make_rig(sensors__velocity="derived", **values), np.ones(50))[:, V]

    own, late = velocities(), velocities(sensors__displacement_lag=0.004, sensors__velocity_lag=0.5)
    np.testing.assert_array_equal(late[2:], own[:-2])


def test_a_tilt_between_rigs_is_refused():
    axes = ("east/x", "west/x")
    words = [("/**", "axes", list(axes)), ("rig", "simulated.sensors.tilt", [1.0, 0.02, 0.0, 1.0])]
    words += [("/**", "specimen.mass", 50.0), ("/**", "specimen.stiffness", 2e5)]
    experiment = Experiment.load([RIG_TABLE], [], words, nodes=["rig"])
    with pytest.raises(InputError, match=r"sensors.tilt \[\[1.0, 0.02\], .* different rigs"):
        Rig(experiment["rig"], axes, experiment.timebase, rigs_of(axes)[0])
