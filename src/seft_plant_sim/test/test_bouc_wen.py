"""Bouc-Wen springs against closed forms, published relations and an ODE solver."""

import itertools

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import hyp2f1
from springs_at_hand import A, Y, hysteretic, spring, through


def bouc_wen(n=1.0, **changes):
    values = {f"bouc_wen__{k}": v for k, v in changes.items()}
    return spring("bouc_wen", bouc_wen__exponent=n, **values)


@pytest.mark.parametrize("n", [1.0, 1.4, 2.0, 3.0, 7.5, 20.0])
def test_bouc_wen_of_any_exponent_loads_as_published(n):
    """e = z 2F1(1, 1/n; 1 + 1/n; (z/z_y)^n), Charalampakis & Koumousis 2008 (J. Sound Vib. 309)."""
    path = through(0, 2.5)
    z = hysteretic(bouc_wen(n), path)
    some = slice(20, None, 97)
    ratio = z[some] / Y
    # near its limit z says little of e: hold z against the inverse of the relation
    expected = [
        brentq(lambda r, e=e: r * hyp2f1(1, 1 / n, 1 + 1 / n, r**n) - e, 0, 1 - 1e-15, xtol=1e-14)
        for e in path[some] / Y
    ]
    np.testing.assert_allclose(ratio, expected, atol=2e-6)


def baber_wen(path, n, beta, gamma, losses):
    """Baber & Wen (1981) by an ODE solver, branch by branch; e is the time of each branch."""
    d_a, d_nu, d_eta = losses
    state, found = np.zeros(2), [0.0]
    for start, end in itertools.pairwise(path):
        sign = np.sign(end - start)

        def slope(_, s, sign=sign):
            z, energy = s
            amplitude, nu, eta = 1 - d_a * energy, 1 + d_nu * energy, 1 + d_eta * energy
            same = beta * np.sign(z * sign) + gamma
            rate = (amplitude - nu * same * abs(z / Y) ** n) / eta
            return [sign * rate, sign * (1 - A) * z / Y**2]

        state = solve_ivp(
            slope, (0, abs(end - start)), state, "DOP853", rtol=1e-11, atol=[1e-14, 1e-11]
        ).y[:, -1]
        found.append(state[0])
    return np.array(found)


@pytest.mark.parametrize("losses", [(0.02, 0, 0), (0, 0.1, 0), (0, 0, 0.1), (0.01, 0.05, 0.08)])
@pytest.mark.parametrize("n", [1.0, 2.0])
def test_degradation_is_that_of_baber_and_wen(n, losses):
    path = through(0, 2, -3, 4, -4, 1, points=40)
    names = ("amplitude_loss", "strength_loss", "stiffness_loss")
    one = bouc_wen(n, beta=0.9, gamma=0.3, **dict(zip(names, losses, strict=True)))
    expected = baber_wen(path, n, 0.9, 0.3, losses)
    np.testing.assert_allclose(hysteretic(one, path), expected, atol=3e-5 * Y)
    as_new = hysteretic(bouc_wen(n, beta=0.9, gamma=0.3), path)
    assert np.abs(as_new - expected).max() > 0.05 * Y  # it does degrade
