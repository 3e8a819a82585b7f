"""States: NamedTuples of arrays whose shapes stand beside their fields."""

from typing import Annotated, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats, Ints, clear, zeros

RECORD = np.dtype([("weight", "f8"), ("wrong", "i8", 2)])


class Inner(NamedTuple):
    count: Annotated[Ints, 2]
    known: Annotated[np.recarray, RECORD, "n"]


class Outer(NamedTuple):
    line: Annotated[Floats, 3, "n"]
    inner: Inner
    given: Floats


def test_arrays_have_the_shapes_beside_their_fields_and_are_cleared_with_those_inside():
    inner, given = zeros(Inner, {"n": 4}), np.ones(2)
    state = zeros(Outer, {"n": 4}, inner=inner, given=given)
    assert (state.line.shape, inner.count.dtype, inner.known.wrong.shape) == ((3, 4), int, (4, 2))
    assert state.given is given
    state.line[:], inner.count[:], inner.known.wrong[:] = 1.0, 2, 3
    clear(state)
    assert not (state.line.any() or inner.count.any() or inner.known.wrong.any() or given.any())
