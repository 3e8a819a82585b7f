"""Anti-aliasing filters against the analytic Butterworth low-pass of second order."""

import numpy as np
import pytest
from bare_rig import BareRig, rig_section
from seft_plant_sim.continuous_model import delayed_force, with_low_pass
from seft_plant_sim.rig import continuous_model
from seft_plant_sim.specimen import Specimen

PAIR = Specimen(
    np.array([[60.0, 5.0], [5.0, 45.0]]),
    np.array([[900.0, -200.0], [-200.0, 700.0]]),
    np.array([[3.0e5, -1.0e5], [-1.0e5, 2.5e5]]),
)
CUTOFF = 80.0


def transfer(model, hz):
    """From drives to outputs, shape (4n, n)."""
    s = 2j * np.pi * hz
    return model.c @ np.linalg.solve(s * np.eye(len(model.a)) - model.a, model.b) + model.d


def butterworth(hz):
    """|H|^2 = 1 / (1 + (w/wc)^4), poles at wc e^(+-3 pi j / 4)."""
    pole = np.exp(0.75j * np.pi)
    s = 1j * hz / CUTOFF
    return 1 / ((s - pole) * (s - pole.conjugate()))


@pytest.mark.parametrize("hz", [0.01, 5.0, 40.0, 80.0, 160.0, 1000.0])
def test_every_output_has_the_gain_and_phase_of_the_filter(hz):
    model = delayed_force(PAIR, 0.003)
    filtered = with_low_pass(model, CUTOFF)
    expected = transfer(model, hz) * butterworth(hz)
    scale = np.abs(expected).max()
    np.testing.assert_allclose(transfer(filtered, hz), expected, rtol=1e-7, atol=1e-12 * scale)
    assert abs(butterworth(hz)) == pytest.approx((1 + (hz / CUTOFF) ** 4) ** -0.5)
    assert filtered.delay == 0.003
    assert filtered.drive == model.drive


def test_the_specimen_does_not_feel_its_sensors():
    model = delayed_force(PAIR, 0.0)
    filtered = with_low_pass(model, CUTOFF)
    size = len(model.a)
    np.testing.assert_array_equal(filtered.a[:size, :size], model.a)
    assert not filtered.a[:size, size:].any()


@pytest.mark.parametrize("kind", ["ideal", "servo_hydraulic_linear", "servo_hydraulic"])
def test_a_sampled_sine_has_the_gain_and_phase_of_the_filter(kind):
    """All four quantities of a rig, in the steady state; the drive is held between samples."""
    hz, dt, amplitude = 20.0, 0.0005, 0.01 if kind.startswith("servo") else 100.0
    turn = np.exp(2j * np.pi * hz * dt * np.arange(4000))

    def steady(cutoff):
        section = rig_section(
            specimen__damping=2000.0,
            actuator__kind=kind,
            actuator__leakage=3e3,
            sensors__anti_alias=cutoff,
        )
        plant = BareRig(continuous_model(section, ("x",)), dt, linear=True)
        plant.reset()
        samples = np.array([plant.step(np.array([u])) for u in amplitude * turn.imag])
        return 2 * np.mean(samples[2000:, :, 0] * turn[2000:, np.newaxis].conj(), axis=0)

    ratio = steady(CUTOFF) / steady(0.0)
    # the held drive's image at 1980 Hz moves force and acceleration of the ideal rig a little
    np.testing.assert_allclose(ratio, butterworth(hz), rtol=1e-4 if kind != "ideal" else 0.05)
    np.testing.assert_allclose(ratio[:2], butterworth(hz), rtol=2e-3)
