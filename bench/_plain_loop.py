"""The floor of the offline loop: the same closed loop in plain floats, no objects, no n."""

import time

import numpy as np
from scipy.linalg import expm
from scipy.signal import cont2discrete


def steps_per_second(ground_motion: list[float], dt: float = 0.002) -> float:
    """Run the paper's rig at mass ratio 0.5, five states, whole-sample delay, no noise."""
    m, k, c = 52.7, 2.11e5, 903.5
    oil, leakage, gain, wv, zv = 1.664e7, 20.0, 0.038527, 2 * np.pi * 60, 0.7
    a = np.zeros((6, 6))
    a[0, 1] = 1
    a[1, :3] = -k / m, -c / m, 1 / m
    a[2, 1:4] = -oil, -leakage, oil * gain
    a[3, 4] = 1
    a[4, 3:6] = -(wv**2), -2 * zv * wv, wv**2
    e = expm(a * dt)
    (
        (p00, p01, p02, p03, p04, g0),
        (p10, p11, p12, p13, p14, g1),
        (p20, p21, p22, p23, p24, g2),
        (p30, p31, p32, p33, p34, g3),
        (p40, p41, p42, p43, p44, g4),
    ) = e[:5].tolist()
    numerator, denominator, _ = cont2discrete(([37.0], [1.0, 17.14, 4002.0]), dt, "bilinear")
    b0, b1, b2 = numerator.ravel().tolist()
    _, a1, a2 = denominator.tolist()
    x = v = f = w = r = command = e1 = e2 = u1 = u2 = 0.0
    start = time.perf_counter()
    for ag in ground_motion:
        acceleration = (f - k * x - c * v) / m
        error = -1.5 * m * ag - 0.5 * m * acceleration - f
        u = b0 * error + b1 * e1 + b2 * e2 - a1 * u1 - a2 * u2
        u = 10.0 if u > 10.0 else -10.0 if u < -10.0 else u
        e2, e1, u2, u1 = e1, error, u1, u
        x, v, f, w, r = (
            p00 * x + p01 * v + p02 * f + p03 * w + p04 * r + g0 * command,
            p10 * x + p11 * v + p12 * f + p13 * w + p14 * r + g1 * command,
            p20 * x + p21 * v + p22 * f + p23 * w + p24 * r + g2 * command,
            p30 * x + p31 * v + p32 * f + p33 * w + p34 * r + g3 * command,
            p40 * x + p41 * v + p42 * f + p43 * w + p44 * r + g4 * command,
        )
        command = u
    return len(ground_motion) / (time.perf_counter() - start)
