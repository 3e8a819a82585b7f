"""Rigs of other masses and oil columns than the paper's, with all else scaled to fit."""

import math
from functools import cache

import numpy as np
from experiments_at_hand import load
from seft_msgs_py.config.facts import CHANNELS
from seft_ros.design.plausibility import expected_response
from seft_ros.design.preflight_tables import planned_motion

TRAVEL, SPEED = 0.02, 0.15
"""Largest displacement, m, and velocity, m/s, of a test; one of them is reached."""
OPENING, SHARE = 0.5, 0.25
"""Of the valve, and of the force capacity, that a linear test uses."""
COMPRESSION = 1.5e-3
"""Of the oil at the force capacity, m, at least: 1.5 % of its length under 21 MPa."""
LEAKAGE, DEAD_TIME = 50.0, 0.001  # 1/s and s
YIELDS = 1.0 / 3.0
"""Yield displacement over the largest displacement of the linear test."""


def response_of(words):
    """Time, and displacement, velocity, acceleration and force of the linear test, (4, N)."""
    test = load(*words, config="demo")
    found = expected_response(test, planned_motion(test))
    return test.timebase.dt, found.states[:, :, 0].T


@cache
def demo_peaks():
    """Largest value of each quantity in the demo."""
    return np.abs(response_of(())[1]).max(axis=1)


@cache
def scaled(mass, oil_hz, rate, hz, mass_ratio, leakage, zeta):
    """Words of the structure and its motion, flow gain, oil stiffness, capacity and peaks."""
    stiffness = mass * (2 * math.pi * hz) ** 2
    damping = 2 * zeta * math.sqrt(stiffness * mass)
    words = [
        f"rate:={float(rate)}",
        f"specimen.mass:={float(mass)}",
        f"specimen.stiffness:={stiffness}",
        f"specimen.damping:={damping}",
        f"reference_force:mass_ratio:={float(mass_ratio)}",
    ]
    dt, unit = response_of((*words, f"ground_motion:peak_force:={float(mass)}"))
    factor = min(TRAVEL / np.abs(unit[0]).max(), SPEED / np.abs(unit[1]).max())
    words.append(f"ground_motion:peak_force:={factor * mass}")
    _, v, _, f = factor * unit
    oil = mass * (2 * math.pi * oil_hz) ** 2
    flow = np.abs(v + (np.gradient(f, dt) + leakage * f) / oil).max()
    capacity = max(np.abs(f).max() / SHARE, COMPRESSION * oil)
    gain = flow / (OPENING * 10.0 * math.sqrt(1.0 - SHARE))
    return tuple(words), gain, oil, capacity, np.abs(factor * unit).max(axis=1)


def scaled_rig(
    mass,
    oil_hz,
    rate,
    hz,
    mass_ratio=1.0,
    kind="linear",
    seed=1,
    gain_error=0.0,
    dead_time_error=0.0,
    oil_error=0.0,
    leakage=LEAKAGE,
    zeta=0.03,
    noise=1.0,
):
    """Words of a test on a specimen of a mass (kg) and frequency (Hz), on an oil column (Hz).

    The errors are those of what the controller knows: relative, of the dead time in s. The noise
    is so much of the demo's, relative to the peaks.
    """
    words, gain, oil, capacity, peaks = scaled(mass, oil_hz, rate, hz, mass_ratio, leakage, zeta)
    true = {"flow_gain": gain, "oil_stiffness": oil, "leakage": leakage, "force_capacity": capacity}
    true["friction"] = 10.0 / 24500.0 * capacity
    true["dead_time"] = DEAD_TIME + max(-dead_time_error, 0.0)
    known = true | {
        "flow_gain": gain * (1.0 + gain_error),
        "oil_stiffness": oil * (1.0 + oil_error),
        "dead_time": DEAD_TIME + max(dead_time_error, 0.0),
    }
    noises = noise * np.array((5e-6, 1e-3, 0.05, 3.0)) * peaks / demo_peaks()
    values = {
        "rig:simulated.actuator": true | {"stroke": 5.0 * peaks[0]},
        "actuator": known,
        "sensors": {
            **dict(zip((f"{name}_range" for name in CHANNELS), 5.0 * peaks, strict=True)),
            **dict(zip((f"{name}_noise" for name in CHANNELS), noises, strict=True)),
        },
        "limits": dict(zip(CHANNELS, (4.0, 4.0, 4.5, 2.5) * peaks, strict=True)),
    }
    more = [f"rig:seed:={seed}", f"rig:simulated.specimen.kind:={kind}"]
    if kind != "linear":
        more.append(f"rig:simulated.specimen.yield_displacement:={YIELDS * peaks[0]}")
    for group, of in values.items():
        more += [f"{group}.{name}:={value}" for name, value in of.items()]
    return [*words, *more]
