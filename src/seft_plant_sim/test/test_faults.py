"""Faults of the simulated rig: their grammar, and what each does to a signal."""

import numpy as np
import pytest
from bare_rig import rig_section
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes, Timebase
from seft_plant_sim.simulated.faults import (
    Fault,
    check_times,
    faults_of,
    obey,
    read_faults,
    show_fault,
)

DT = 0.002
TIMEBASE = Timebase.from_rate(500.0)
CONVERTER = {
    "sensors__adc_bits": 12,
    "sensors__displacement_range": 0.1,
    "sensors__velocity_range": 1.0,
    "sensors__acceleration_range": 40.0,
    "sensors__force_range": 2048.0,
}


def arrays(*lines, axes=("x",), own=None, **values):
    """Faults for the compiled functions, and their memory."""
    own = own or RigAxes.whole(axes)
    section = rig_section(**values)
    bits = section["simulated.sensors.adc_bits"]
    resolution = np.full((4, len(own.axes)), 2.0 * 2048.0 / 2.0**bits if bits else 0.0)
    found, width = faults_of(read_faults(lines, axes), own, TIMEBASE, resolution, 0, section)
    return found, np.zeros((len(found.numbers), width))


def shown(line, signal, row=3, **values):
    """What a sensor shows of a signal, shape (N,)."""
    faults, memory = arrays(line, **values)
    noise, found = np.ones((5, 1)), []
    for step, fault_free in enumerate(signal):
        measured = np.full((4, 1), fault_free)
        show_fault(faults, step, noise, memory, measured)
        others = np.delete(measured, row, axis=0)
        np.testing.assert_array_equal(others, fault_free)
        found.append(measured[row, 0])
    return found


def obeyed(line, signal, **values):
    """What a valve does of commands, shape (N,)."""
    faults, memory = arrays(line, **values)
    return [obey(faults, step, memory, 0, fault_free) for step, fault_free in enumerate(signal)]


def test_a_line_has_axis_what_kind_value_time_and_steps():
    lines = [
        "force set -5589.0 at 5.25 for 1",
        "east/y/displacement flip at 0",
        "valve open -9 at 2",
    ]
    assert read_faults(lines, ("east/x", "east/y")) == [
        Fault(lines[0], "", "force", "set", -5589.0, 5.25, 1),
        Fault(lines[1], "east/y", "displacement", "flip", 0.0, 0.0, None),
        Fault(lines[2], "", "valve", "open", -9.0, 2.0, None),
    ]
    assert read_faults("", ("x",)) == []
    assert read_faults("y/force freeze at 1e-1 for 20", ("x", "y"))[0].steps == 20


@pytest.mark.parametrize(
    ("line", "error"),
    [
        ("force", r"a fault is \[AXIS/\]WHAT KIND \[VALUE\] at TIME \[for STEPS\], such as"),
        ("force set 3 at 2 for", "a fault is"),
        ("load set 3 at 2", "load can't fail; displacement, .*, valve, supply, specimen can"),
        ("force stick at 2", "force can't stick; it can set, add, .*, bit"),
        ("valve noise 1 at 2", "valve can't noise; it can stick, open, slow, null, hysteresis, s"),
        ("y/force set 3 at 2", "there is no axis y; there are x"),
        ("force set at 2", "set needs a value"),
        ("force freeze 3 at 2", "freeze takes no value"),
        ("force set high at 2", "high is no number"),
        ("valve set nan at 2", "nan is no number"),
        ("force noise -1 at 2", "noise needs an RMS of at least 0"),
        ("force late -0.1 at 2", "late needs a time of 0 to 10 s"),
        ("force lowpass 0 at 2", "lowpass needs a cut-off above 0 Hz"),
        ("supply set 3 at 2", "supply can't set; it can scale"),
        ("specimen break 1.5 at 2", "break needs the stiffness that is left, 0 to 1"),
        ("specimen collide 0 at 2", "collide needs the stiffness of a stop, above 0 N/m"),
        ("force bit 1.5 at 2", "bit needs the number of a bit"),
        ("force set 3 at -2", "TIME is -2, but must be a time in s of the test"),
        ("force set 3 at 2 for 0", "STEPS is 0, but must be a whole number of samples, at least 1"),
        ("force set 3 at 2 for 1e30", "STEPS is 1e30, but must be a whole number of samples"),
        ("force set 3 at 1e300", "TIME is 1e300, but must be a time in s of the test, 0 to"),
    ],
)
def test_a_wrong_line_says_what_is_possible(line, error):
    with pytest.raises(InputError, match=error) as raised:
        read_faults(line, ("x",))
    assert str(raised.value).startswith(f'rig: faults: "{line}": ')


def test_a_fault_begins_in_the_test():
    check_times("force flip at 5.25", ("x",), 5.25)
    with pytest.raises(InputError, match=r"the test ends at 5\.2 s, before the fault begins"):
        check_times(["force flip at 1", "force flip at 5.25"], ("x",), 5.2)


@pytest.mark.parametrize(
    ("line", "values", "error"),
    [
        ("force bit 3 at 1", {}, r"there is no converter; give rig: simulated\.sensors\.adc_bits"),
        ("force bit 12 at 1", CONVERTER, r"the converter has the bits 0 to 11"),
        ("supply scale 0.5 at 1", {"actuator__kind": "delay"}, "delay has no supply pressure"),
        ("velocity flip at 1", {"sensors__velocity": "derived"}, "there is no sensor of it"),
        ("valve open 3 at 1", {"actuator__kind": "ideal"}, "ideal has no valve: its force can st"),
    ],
)
def test_what_a_rig_does_not_have_can_not_fail(line, values, error):
    with pytest.raises(InputError, match=error):
        arrays(line, **values)


SIGNAL = [1.0, 2.0, 4.0, 7.0, 11.0, 16.0]


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("force set -5.5 at 0.004 for 1", [1, 2, -5.5, 7, 11, 16]),
        ("force add 10 at 0.004 for 2", [1, 2, 14, 17, 11, 16]),
        ("force scale 0.5 at 0.004", [1, 2, 2, 3.5, 5.5, 8]),
        ("force drift 100 at 0.004", [1, 2, 4, 7.2, 11.4, 16.6]),
        ("force noise 3 at 0.004", [1, 2, 7, 10, 14, 19]),
        ("force freeze at 0.004 for 3", [1, 2, 4, 4, 4, 16]),
        ("force late 0.004 at 0.004", [1, 2, 1, 2, 4, 7]),
        ("force late 0.003 at 0.004", [1, 2, 1.5, 3, 5.5, 9]),
        ("force late 1 at 0.004", [1, 2, 1, 1, 1, 1]),
        ("force flip at 0.0041", [1, 2, 4, -7, -11, -16]),
        ("valve stick at 0.004 for 3", [1, 2, 4, 4, 4, 16]),
        ("valve open -10 at 0.004", [1, 2, -10, -10, -10, -10]),
        ("valve null 100 at 0.004", [1, 2, 4, 7.2, 11.4, 16.6]),
        ("valve set 3 at 0.004 for 1", [1, 2, 3, 7, 11, 16]),
        ("valve add 2 at 0.004", [1, 2, 6, 9, 13, 18]),
        ("valve late 0.004 at 0.004", [1, 2, 1, 2, 4, 7]),
    ],
)
def test_a_sensor_shows_its_fault_and_a_valve_obeys_it(line, expected):
    found = (obeyed if line.startswith("valve") else shown)(line, SIGNAL)
    np.testing.assert_allclose(found, expected, rtol=1e-14)


def test_a_sensor_may_show_what_is_no_number():
    assert np.isnan(shown("force set nan at 0.004 for 1", SIGNAL)[2])


def test_a_low_pass_filter_halves_the_power_at_its_cut_off():
    time = DT * np.arange(5000)
    for line, row in (("force lowpass 20 at 0", 3), ("velocity lowpass 20 at 0", 1)):
        found = np.array(shown(line, np.sin(2 * np.pi * 20.0 * time), row))
        # the bilinear transform bends the frequency: tan(pi f dt) / (pi f dt)
        bent = np.tan(np.pi * 20.0 * DT) / (np.pi * 20.0 * DT)
        expected = 1.0 / np.sqrt(1.0 + bent**2)
        assert np.sqrt(2.0 * np.mean(found[500:] ** 2)) == pytest.approx(expected, rel=1e-3)
    late = shown("force lowpass 20 at 0.1", np.ones(200))
    np.testing.assert_allclose(late, 1.0, rtol=1e-12)  # it begins in the steady state


def test_a_bit_of_the_converter_flips():
    codes = np.array([0, 1, 100, -1, -100, 2047, -2048, 2048], dtype=float)  # of 1 N
    for bit in range(12):
        expected = []
        for code in np.clip(codes, -2048, 2047).astype(int):
            flipped = (code & 0xFFF) ^ 1 << bit
            expected.append(flipped - 4096 if flipped >= 2048 else flipped)
        assert shown(f"force bit {bit} at 0", codes, **CONVERTER) == expected
    lost = shown("force bit 3 at 0", [np.nan], **CONVERTER)
    assert np.isnan(lost[0])


def test_a_valve_with_hysteresis_follows_half_its_width_behind():
    signal = [0.0, 1.0, 2.0, 1.5, 1.0, 0.0, -2.0]
    found = obeyed("valve hysteresis 1 at 0", signal)
    assert found == [0.0, 0.5, 1.5, 1.5, 1.5, 0.5, -1.5]


def test_a_slow_valve_is_a_low_pass_filter():
    found = obeyed("valve slow 10 at 0", [0.0] + [1.0] * 99)
    time = DT * (np.arange(99) + 0.5)
    np.testing.assert_allclose(found[1:], 1.0 - np.exp(-2 * np.pi * 10.0 * time), atol=2e-3)


def test_faults_act_in_their_order_and_on_their_axis():
    lines = ("y/force add 1 at 0", "force scale 2 at 0", "x/force flip at 0")
    faults, memory = arrays(*lines, axes=("x", "y"))
    measured = np.full((4, 2), 3.0)
    show_fault(faults, 0, np.zeros((4, 2)), memory, measured)
    assert measured[3].tolist() == [-6.0, 8.0]
    assert (measured[:3] == 3.0).all()
