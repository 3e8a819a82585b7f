"""Anti-aliasing filters against the analytic Butterworth low-pass of second order."""

import numpy as np
import pytest
from seft_plant_sim.continuous_model import delayed_force, with_low_pass
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
