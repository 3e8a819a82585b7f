"""Velocity derived from displacement: s / (1 + s / w_c), discretised by the bilinear transform."""

import numpy as np
import pytest
from seft_plant_sim.channels import Derivation, derive_velocity
from seft_plant_sim.simulated.sensors import Channels, measure_channels

DT = 0.002


def measured(states, cutoff=100.0, **rows):
    """Samples of one axis as measured, shape (N, 4, 1)."""
    nothing, no_end = np.zeros((4, 1)), np.full((4, 1), np.inf)
    values = {"bias": nothing, "range": no_end, "resolution": nothing}
    channels = Channels(nothing, **(values | rows))
    section = {"sensors.velocity": "derived", "sensors.acceleration": "measured"}
    section["sensors.velocity_cutoff"] = cutoff
    derivation = Derivation.from_parameters(section, DT)
    samples = np.zeros(states.shape)
    for step, state in enumerate(states):
        measure_channels(channels, state.ravel(), nothing, samples[step])
        derive_velocity(derivation, step, samples[max(step - 1, 0)], samples[step])
    return samples


def derived(displacement, cutoff=100.0):
    """Velocity of each displacement of one axis."""
    states = np.zeros((len(displacement), 4, 1))
    states[:, 0, 0] = displacement
    return measured(states, cutoff=cutoff)[:, 1, 0]


@pytest.mark.parametrize("cutoff", [20.0, 100.0])
@pytest.mark.parametrize("hz", [0.5, 10.0, 40.0, 120.0])
def test_gain_and_phase_are_those_of_the_filtered_derivative(hz, cutoff):
    """The bilinear transform puts the analog frequency (2/dt) tan(w dt/2) at w, exactly."""
    time = DT * np.arange(5000)
    turn = np.exp(2j * np.pi * hz * time)
    late = slice(2500, 5000)  # 5 s in: whole periods of every frequency above
    gain = np.mean(derived(turn.imag, cutoff)[late] * turn[late].conj()) * 2j
    s = 2j / DT * np.tan(np.pi * hz * DT)
    assert gain == pytest.approx(s / (1 + s / (2 * np.pi * cutoff)), rel=1e-6)


def test_it_settles_on_an_offset_at_once():
    """A laboratory's filter has been running for long when a test starts."""
    np.testing.assert_array_equal(derived(np.full(50, 3e-3)), 0.0)


def test_it_sees_the_displacement_as_it_is_measured():
    """Bias does not move it; range and converter do."""
    rows = {"bias": np.full((4, 1), 0.02), "range": np.full((4, 1), 0.05)}
    rows["resolution"] = np.full((4, 1), 0.01)
    x = 0.06 * np.sin(2 * np.pi * 2.0 * DT * np.arange(400))
    states = np.zeros((400, 4, 1))
    states[:, 0, 0] = x
    states[:, 1, 0] = 77.0  # the true velocity is not looked at
    samples = measured(states, **rows)
    seen = np.rint(np.clip(x + 0.02, -0.05, 0.05) / 0.01) * 0.01
    np.testing.assert_allclose(samples[:, 0, 0], seen, atol=1e-15)
    np.testing.assert_allclose(samples[:, 1, 0], derived(seen), atol=1e-12)
