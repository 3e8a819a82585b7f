"""Energy balance: closed forms, and that it closes on the true samples of rigs."""

import dataclasses

import numpy as np
import pytest
import springs_at_hand
from bare_rig import BareRig, driven, rig_section
from seft_msgs_py.config.parameter_table import group
from seft_plant_sim.simulated.rig import continuous_model
from seft_plant_sim.simulated.specimen import Specimen, energy_balance

DT = 0.002
M, C, K = 52.7, 800.0, 2.11e5
ONE = Specimen(np.array([[M]]), np.array([[C]]), np.array([[K]]))
COUNT = 2000
LAWS = {"linear": {}} | springs_at_hand.LAWS


def shaken_rig(commands, law, kind="servo_hydraulic", specimen=None, **actuator):
    """Specimen and true samples, shape (N, 4, n), of a rig under these commands."""
    values = specimen or {"mass": M, "damping": C, "stiffness": K}
    if law:
        values = {"yield_displacement": 0.0015} | values | law
    values = {f"specimen.{name}": value for name, value in values.items()}
    actuator = {"kind": kind, "friction": 10.0} | actuator
    section = rig_section(**values, **{f"actuator.{name}": own for name, own in actuator.items()})
    axes = ("x", "y")[: commands.shape[1]]
    plant = BareRig(continuous_model(section, axes), DT)
    specimen = Specimen.from_parameters(group(section, "simulated.specimen"), axes, "specimen")
    return specimen, driven(plant, commands)[:, :4]


def drive_of(kind, axes=1):
    """Sine or earthquake-like drive, shape (N, n), that ends before the recording does."""
    time = DT * np.arange(COUNT)[:, np.newaxis] + np.zeros(axes)
    if kind == "sine":
        drive = np.sin(2 * np.pi * 8.0 * time + np.arange(axes))
    else:  # noise in the band of an earthquake, under an envelope
        hz = np.fft.rfftfreq(COUNT, DT)[:, np.newaxis]
        white = np.random.default_rng(4).normal(size=(COUNT, axes))
        drive = np.fft.irfft(np.fft.rfft(white, axis=0) * (hz < 25) / (1 + hz / 5), COUNT, axis=0)
        drive *= time * np.exp(-time) / np.abs(drive).max() * 2
    return drive * (time < 3.0)


def balance_of(specimen, samples, **options):
    x, v, _, f = np.moveaxis(samples, 1, 0)
    return energy_balance(specimen, x, v, f, DT, **options)


@pytest.mark.parametrize(
    ("kind", "motion", "law"),
    [
        *(("servo_hydraulic", "earthquake", name) for name in LAWS),
        *(("servo_hydraulic_linear", "sine", name) for name in ("linear", "bilinear")),
        *((kind, "earthquake", "Bouc-Wen") for kind in ("ideal", "delay")),
    ],
)
def test_the_balance_of_true_samples_closes(kind, motion, law):
    """To 0.2 % of the largest input at any time, whatever the actuator and the specimen."""
    drive, law = drive_of(motion), LAWS[law]
    shares = {"ideal": ({"held": 1.0}, 0.0), "delay": ({"held": 0.65}, 0.0033)}
    held, late = shares.get(kind, ({}, 0.0))
    amplitude = 900.0 if held else 4.0
    specimen, samples = shaken_rig(amplitude * drive, law, kind, delay=late)
    balance = balance_of(specimen, samples, **held)
    assert np.abs(balance.error).max() < 2e-3
    if law.get("kind") in ("gap", "duffing"):
        assert not balance.hysteretic.any()
    elif law:
        assert balance.hysteretic[-1] > 0.2 * balance.input[-1]  # it did yield
        loss = np.diff(balance.hysteretic)
        assert loss.min() > -1e-5 * balance.input[-1]
    else:
        assert not balance.hysteretic.any()


def steady(hz, count=COUNT):
    """Exact steady state of x = X sin wt on the linear specimen, and w."""
    w, t = 2 * np.pi * hz, DT * np.arange(count)
    x, v, a = 0.005 * np.array([np.sin(w * t), w * np.cos(w * t), -(w**2) * np.sin(w * t)])
    return w, np.stack([x, v, a, M * a + C * v + K * x], axis=1)[..., np.newaxis]


@pytest.mark.parametrize("hz", [1.0, 10.0, 25.0, 60.0])
def test_a_cycle_of_the_steady_state_puts_in_pi_c_w_times_the_amplitude_squared(hz):
    w, samples = steady(hz)
    balance = balance_of(ONE, samples)
    seconds = int(DT * COUNT) - 1
    cycles = np.pi * C * w * 0.005**2 * hz * seconds
    first, last = 100, 100 + round(seconds / DT)
    assert balance.input[last] - balance.input[first] == pytest.approx(cycles, rel=3e-3)
    assert balance.damped[last] - balance.damped[first] == pytest.approx(cycles, rel=3e-3)
    start = balance.input[0] - balance.kinetic[0] - balance.strain[0]
    left = balance.input - balance.kinetic - balance.strain - balance.damped - start
    assert np.abs(left).max() < 1e-2 * 0.5 * M * (0.005 * w) ** 2


def test_a_wrong_specimen_does_not_close():
    specimen, samples = shaken_rig(4.0 * drive_of("earthquake"), LAWS["bilinear"])
    for wrong in (
        dataclasses.replace(specimen, mass=2.0 * specimen.mass),
        dataclasses.replace(specimen, damping=1.2 * specimen.damping),
        Specimen(specimen.mass, specimen.damping, specimen.stiffness),  # that does not yield
    ):
        assert np.abs(balance_of(wrong, samples).error).max() > 0.02


def test_the_error_of_a_specimen_at_rest_is_no_number():
    balance = balance_of(ONE, np.zeros((5, 4, 1)))
    assert np.isnan(balance.error).all()
    for field in dataclasses.fields(balance):
        np.testing.assert_array_equal(getattr(balance, field.name), np.zeros(5))
