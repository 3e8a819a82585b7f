"""Restoring forces: the bilinear closed form, and what holds for every law."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_plant_sim.restoring_force import BilinearSpring, BoucWenSpring

K, Y, A = 2.11e5, 0.004, 0.1
BILINEAR = BilinearSpring(K, Y, A)


def bouc_wen(n=1.0, **changes):
    return BoucWenSpring(K, Y, A, exponent=n, **changes)


SPRINGS = {
    "bilinear": BILINEAR,
    "Bouc-Wen": bouc_wen(),
    "smooth": bouc_wen(1.5, beta=0.9, gamma=0.1),
    "degrading": bouc_wen(2.0, strength_loss=0.05, stiffness_loss=0.08, amplitude_loss=0.01),
}
springs = pytest.mark.parametrize("spring", SPRINGS.values(), ids=SPRINGS)


def through(*turns, points=4000):
    """Path of deformation from one turning point to the next, in yield displacements."""
    parts = [np.linspace(a, b, points)[1:] for a, b in itertools.pairwise(turns)]
    return Y * np.concatenate([[turns[0]], *parts])


def forces(spring, path):
    z = spring.follow(path)
    return np.array([spring.force(e, hyst) for e, hyst in zip(path, z, strict=True)]), z


def work(force, path):
    return np.sum((force[1:] + force[:-1]) / 2 * np.diff(path))


def dissipated(spring, path):
    """Work done on a spring that it does not give back, J."""
    force, z = forces(spring, path)
    return work(force, path) - spring.strain_energy(path[-1], z[-1])


def test_bilinear_branches_are_those_of_kinematic_hardening():
    """Loading K to yield, then a K; unloading is elastic over twice the yield displacement."""
    path = through(0, 3, -3, 3)
    force, _ = forces(BILINEAR, path)
    top = K * (Y + A * 2 * Y)
    loading = path[:4000]
    expected = np.where(loading < Y, K * loading, K * Y + A * K * (loading - Y))
    np.testing.assert_allclose(force[:4000], expected, atol=1e-9 * top)
    back = path[3999:7999]
    elastic = back > 3 * Y - 2 * Y
    unloading = np.where(elastic, top - K * (3 * Y - back), top - 2 * K * Y - A * K * (Y - back))
    np.testing.assert_allclose(force[3999:7999], unloading, atol=1e-9 * top)
    np.testing.assert_allclose(force[-1], top, rtol=1e-12)  # the loop is closed


@pytest.mark.parametrize("ductility", [1.0, 1.5, 3.0, 10.0])
@pytest.mark.parametrize("hardening", [0.0, 0.05, 0.5])
def test_a_bilinear_cycle_dissipates_4_times_force_and_plastic_deformation(ductility, hardening):
    """4 (1 - a) F_y (u - u_y), e.g. Chopra, Dynamics of Structures, 4th ed., sec. 7.4."""
    spring = BilinearSpring(K, Y, hardening)
    first = through(0, ductility, points=7 * 600 + 1)
    path = through(0, ductility, -ductility, ductility, points=7 * 600 + 1)
    cycle = dissipated(spring, path) - dissipated(spring, first)
    expected = 4 * (1 - hardening) * K * Y * (ductility - 1) * Y
    assert cycle == pytest.approx(expected, rel=1e-3, abs=1e-9)


@springs
def test_the_hysteretic_displacement_ends_at_the_yield_displacement(spring):
    z = spring.follow(through(0, 30, -30, 30, points=8000))
    assert np.abs(z).max() <= Y * (1 + 1e-12)
    if spring in (BILINEAR, SPRINGS["Bouc-Wen"]):
        assert np.abs(z).max() == pytest.approx(Y, rel=1e-9)


@springs
@pytest.mark.parametrize("factor", [1e-3, 3.0, 1e4])
def test_rates_are_those_of_the_velocity_and_nothing_else(spring, factor):
    """The law is independent of the rate of loading: twice as fast is the same loop."""
    for z in (-0.9 * Y, 0.0, 0.3 * Y, Y):
        for v in (-1.0, 1.0):
            slow, fast = (spring.rate(z, speed * v, 0.7) for speed in (1.0, factor))
            assert fast == pytest.approx(factor * slow, rel=1e-12)
            assert spring.work_rate(z, factor * v) == pytest.approx(
                factor * spring.work_rate(z, v), rel=1e-12
            )


@springs
def test_a_path_in_small_steps_and_in_large_ones_is_the_same_loop(spring):
    coarse = spring.follow(through(0, 3, -2, 4, 0, points=5))
    fine = spring.follow(through(0, 3, -2, 4, 0, points=4001))
    np.testing.assert_allclose(fine[::1000], coarse, atol=1e-5 * Y)


PATHS = st.lists(st.floats(-5, 5), min_size=1, max_size=12)


@settings(max_examples=60, deadline=None)
@given(turns=PATHS, name=st.sampled_from(["bilinear", "Bouc-Wen", "smooth"]))
def test_work_is_strain_energy_and_what_is_dissipated_which_never_shrinks(turns, name):
    """Rate of what is dissipated: (1 - a) k z (e' - z'); at least 0 for beta >= |gamma|."""
    spring = SPRINGS[name]
    path = through(0, *turns, points=400)
    force, z = forces(spring, path)
    done = np.concatenate([[0.0], np.cumsum((force[1:] + force[:-1]) / 2 * np.diff(path))])
    slip = np.diff(path) - np.diff(z)
    lost = (1 - A) * K * np.concatenate([[0.0], np.cumsum((z[1:] + z[:-1]) / 2 * slip)])
    unit = K * Y**2
    np.testing.assert_allclose(done, spring.strain_energy(path, z) + lost, atol=1e-9 * unit)
    # exact for the bilinear law; the others are integrated, in steps of 2 % of z_y at the most
    assert np.diff(lost).min(initial=0.0) > -(1e-14 if spring is BILINEAR else 1e-5) * unit
    assert np.abs(z).max() <= Y * (1 + 1e-9)


@settings(max_examples=60, deadline=None)
@given(turns=PATHS, name=st.sampled_from(list(SPRINGS)))
def test_a_spring_pushed_the_other_way_is_its_mirror_image(turns, name):
    path = through(0, *turns, points=5)
    spring = SPRINGS[name]
    np.testing.assert_array_equal(spring.follow(-path), -spring.follow(path))


@given(st.lists(st.floats(-1, 1), min_size=1, max_size=12))
def test_a_bilinear_spring_that_has_not_yielded_is_linear(turns):
    path = through(0, *turns, points=3)
    force, z = forces(BILINEAR, path)
    np.testing.assert_allclose(z, path, atol=1e-14 * Y)
    np.testing.assert_allclose(force, K * path, atol=1e-12 * K * Y)


@springs
def test_a_jump_of_any_length_is_followed_to_the_limit(spring):
    z = spring.follow([0.0, 1e3, -1e9, 0.0])
    assert np.isfinite(z).all()
    assert np.abs(z).max() <= Y * (1 + 1e-9)
