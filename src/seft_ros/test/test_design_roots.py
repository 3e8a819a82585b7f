import numpy as np
import pytest
from seft_ros.design.plant import Root, lightly_damped, polynomial_of, roots_of


def test_roots_make_their_polynomial():
    pair = Root(np.sqrt(4002.0) / (2 * np.pi), 17.14 / (2 * np.sqrt(4002.0)))
    assert polynomial_of([pair]) == pytest.approx([1.0, 17.14, 4002.0])
    assert polynomial_of([Root(1.0), Root(0.0)]) == pytest.approx([1.0, 2 * np.pi, 0.0])
    assert roots_of(np.roots([1.0, 17.14, 4002.0])) == [
        Root(pytest.approx(pair.hz), pytest.approx(pair.damping))
    ]


def test_an_unstable_real_pole_has_a_negative_frequency():
    (root,) = roots_of([2 * np.pi])
    assert (root.hz, root.damping) == (pytest.approx(-1.0), None)


def test_lightly_damped_are_the_pairs_that_show():
    values = [-1 + 100j, -1 - 100j, -90 + 100j, -90 - 100j, -50, 1 + 80j, 1 - 80j, 60j, -60j]
    found = lightly_damped(roots_of(values))
    assert [round(2 * np.pi * root.hz) for root in found] == [60, 100]
    assert found[0].damping == 0.0
