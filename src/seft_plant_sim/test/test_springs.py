"""Restoring forces: closed forms of each law, and what holds for every law."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from seft_plant_sim.simulated.springs import HystereticSpring, Spring
from springs_at_hand import A, K, Y, spring, through, work

U, FRICTION = 2e-5, 200.0
OWN_BOUC_WEN = {"bouc_wen__exponent": 2.0, "bouc_wen__strength_loss": 0.05}


@dataclass(frozen=True)
class Rounded(HystereticSpring):
    """A law of another package."""

    def rate(self, z, velocity, work):
        share = min(abs(z) / self.yield_displacement, 1.0)
        return velocity * (1.0 - share**2) if z * velocity > 0 else velocity


SPRINGS = {
    "bilinear": spring("bilinear"),
    "Bouc-Wen": spring("bouc_wen"),
    "smooth": spring("bouc_wen", bouc_wen__exponent=1.5, bouc_wen__beta=0.9, bouc_wen__gamma=0.1),
    "degrading": spring("bouc_wen", bouc_wen__stiffness_loss=0.08, **OWN_BOUC_WEN),
    "pinching": spring("pinching", pinching__growth=0.3, **OWN_BOUC_WEN),
    "flag": spring("flag"),
    "friction": spring("friction", friction__force=FRICTION),
    "gap": spring("gap", gap__width=Y, gap__stiffness=5 * K),
    "hardening": spring("duffing", duffing__cubic=0.3 * K / Y**2),
    "softening": spring("duffing", duffing__cubic=-0.1 * K / Y**2),
    "another package's": Spring.of(Rounded(K, Y, A)),
}
CONSERVATIVE = ("gap", "hardening", "softening")
EXACT = ("bilinear", "flag", "friction", *CONSERVATIVE)
springs = pytest.mark.parametrize("name", SPRINGS)


def test_bilinear_branches_are_those_of_kinematic_hardening():
    """Loading K to yield, then a K; unloading is elastic over twice the yield displacement."""
    path = through(0, 3, -3, 3)
    force = SPRINGS["bilinear"].follow(path)[0]
    top = K * (Y + A * 2 * Y)
    loading = path[:4000]
    expected = np.where(loading < Y, K * loading, K * Y + A * K * (loading - Y))
    np.testing.assert_allclose(force[:4000], expected, atol=1e-9 * top)
    back = path[3999:7999]
    elastic = back > 3 * Y - 2 * Y
    unloading = np.where(elastic, top - K * (3 * Y - back), top - 2 * K * Y - A * K * (Y - back))
    np.testing.assert_allclose(force[3999:7999], unloading, atol=1e-9 * top)
    np.testing.assert_allclose(force[-1], top, rtol=1e-12)  # the loop is closed


def test_friction_sticks_until_it_slides_and_turns_at_once():
    path = np.array([0.0, 0.5 * U, U, 3 * U, 2 * U, 1.0 * U, -5 * U])
    force = SPRINGS["friction"].follow(path)[0] - K * path
    np.testing.assert_allclose(force / FRICTION, [0.0, 0.5, 1.0, 1.0, 0.0, -1.0, -1.0], atol=1e-9)


@pytest.mark.parametrize("height", [0.0, 0.3, 1.0])
def test_a_flag_comes_back_to_the_origin_whatever_its_height(height):
    flag = spring("flag", flag__dissipation=height)
    force = flag.follow(through(0, 3, 0, -5, 0, 0.4 * (1 - height), 0))[0]
    assert force[[3999, 7998, 15996, -1]] == pytest.approx(
        [K * Y + 2 * A * K * Y, 0.0, 0.0, 0.0], abs=1e-9 * K * Y
    )


def test_a_flag_unloads_along_its_lower_edge():
    path = Y * np.array([0.0, 3.0, 2.6, 2.5, 1.5, 0.5, 0.2, 0.0])
    force = spring("flag", hardening_ratio=0.0).follow(path)[0] / (K * Y)
    np.testing.assert_allclose(force, [0.0, 1.0, 0.6, 0.5, 0.5, 0.5, 0.2, 0.0], atol=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_second_spring_engages_beyond_the_gap(sign):
    path = sign * np.array([0.0, 0.5, 1.0, 1.5, 2.0]) * Y
    force = sign * SPRINGS["gap"].follow(path)[0] / (K * Y)
    np.testing.assert_allclose(force, [0.0, 0.5, 1.0, 1.5 + 2.5, 2.0 + 5.0], rtol=1e-12)


def test_a_duffing_spring_is_cubic_and_softens_no_further_than_its_largest_force():
    path = through(0, 1.5, -1.5, points=500)
    hard, soft = (SPRINGS[name].follow(path)[0] for name in ("hardening", "softening"))
    np.testing.assert_allclose(hard, K * path + 0.3 * K / Y**2 * path**3, atol=1e-9 * K * Y)
    np.testing.assert_allclose(soft, K * path - 0.1 * K / Y**2 * path**3, atol=1e-9 * K * Y)
    far = SPRINGS["softening"].follow(through(0, 9))[0]
    assert far.max() == far[-1] == pytest.approx(2 / 3 * K * Y * np.sqrt(1 / 0.3))


def test_without_slip_pinching_is_bouc_wen():
    path = through(0, 2, -3, 4, -1, 2, points=300)
    none = spring("pinching", pinching__slip=0.0, **OWN_BOUC_WEN).follow(path)
    np.testing.assert_array_equal(none, spring("bouc_wen", **OWN_BOUC_WEN).follow(path))


def test_pinching_slips_by_twice_its_length_at_each_passage_through_zero_force():
    """The integral of f(z) dz is 2 s (Baber & Noori 1985); s as it has grown (Foliente 1995)."""
    long = {"pinching__growth": 1e3, "pinching__width": 0.1, "hardening_ratio": 0.0}
    pinched, plain = (spring("pinching", pinching__slip=s, **long) for s in (0.7, 0.0))
    reaches = []
    for made, s in ((plain, 0.0), (pinched, 0.7)):
        path = through(0, 3 + s, 3 + s - 2.5 - 2 * s, points=20_000)
        reaches.append(made.follow(path)[0][-1] / (K * Y))
    assert reaches[1] == pytest.approx(reaches[0], abs=2e-3)


@springs
def test_a_path_in_small_steps_and_in_large_ones_is_the_same_loop(name):
    """No time occurs in a law: only the path counts."""
    made = SPRINGS[name]
    coarse = made.follow(through(0, 3, -2, 4, 0, points=5))
    fine = made.follow(through(0, 3, -2, 4, 0, points=4001))[:, ::1000]
    largest = np.maximum(np.abs(coarse).max(axis=1, keepdims=True), 1e-9)
    within = 1e-12 if name in EXACT else 2e-5
    np.testing.assert_allclose(fine / largest, coarse / largest, atol=within)


PATHS = st.lists(st.floats(-5, 5), min_size=1, max_size=12)


@settings(max_examples=25)
@given(turns=PATHS)
@springs
def test_work_is_strain_energy_and_what_is_dissipated_which_never_shrinks(name, turns):
    points = 400 if name == "another package's" else 4000
    path = through(0, *turns, points=points)
    force, stored, dissipated = SPRINGS[name].follow(path)
    unit = K * Y**2
    # the trapezoidal rule cuts the corners
    np.testing.assert_allclose(work(force, path), stored + dissipated, atol=2e5 / points**2 * unit)
    assert stored.min() > -1e-6 * unit
    if name not in ("degrading", "pinching"):  # a spring whose stiffness is lost gives back less
        rounding = 1e-12 if name in EXACT else 1e-5
        assert np.diff(dissipated).min(initial=0.0) >= -rounding * unit
    if name in CONSERVATIVE:
        assert not dissipated.any()


@settings(max_examples=25)
@given(turns=PATHS)
@springs
def test_a_spring_pushed_the_other_way_is_its_mirror_image(name, turns):
    path = through(0, *turns, points=5)
    one, other = SPRINGS[name].follow(path), SPRINGS[name].follow(-path)
    np.testing.assert_array_equal(other[0], -one[0])
    np.testing.assert_array_equal(other[1:], one[1:])


@springs
def test_a_jump_of_any_length_is_followed(name):
    found = SPRINGS[name].follow([0.0, 1e3, -1e9, 0.0])
    assert np.isfinite(found).all()


def test_what_a_law_of_another_package_raises_is_raised():
    class Broken(HystereticSpring):
        def rate(self, z, velocity, work):
            raise ZeroDivisionError("no rate")

    with pytest.raises(ZeroDivisionError, match="no rate"):
        Spring.of(Broken(K, Y, A)).follow([0.0, Y])
