"""The compiled step; alone and in a compiled loop it gives one test: test_offline_ensemble.py."""

import itertools

import numpy as np
from bare_rig import rig_section
from seft_msgs_py.wire.topics import Timebase
from seft_plant_sim.rig import Rig


def test_rigs_do_not_share_what_they_remember():
    """Two at once, step by step, and each for itself."""
    command, section = (
        np.full(1, 3.0),
        rig_section(specimen__kind="bilinear", specimen__yield_displacement=0.003),
    )
    one, other = (Rig.from_parameters(section, ("x",), Timebase.from_rate(500.0)) for _ in "ab")
    one.reset()
    alone = np.array([one.step(command) for _ in range(50)])
    one.reset()
    other.reset()
    pairs = [(one.step(command), other.step(-command)) for _ in range(50)]
    np.testing.assert_array_equal([first for first, _ in pairs], alone)
    for first, second in itertools.islice(pairs, 5):
        assert first is not second
