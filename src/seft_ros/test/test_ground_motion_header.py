"""What headers and names of columns state: unit, sampling period, quantity; none is overridden."""

import numpy as np
import pytest
from seft_msgs_py.errors import InputError
from seft_ros.ground_motion.readers.statements import is_other_unit, read_unit

WAVE = np.sin(0.3 * np.arange(40))
ONE_COLUMN = "".join(f"{value:.5f}\n" for value in WAVE)


def stated(record):
    return record.unit, record.dt


@pytest.mark.parametrize(
    ("unit", "spellings"),
    [
        ("g", ["g", "G", "g's", "(g)", "G."]),
        (
            "cm/s2",
            ["gal", "Gal", "gals", "cm/s^2", "CM/SEC/SEC", "cm/sec2.", "cm/sec**2", "cm s-2"],
        ),
        ("cm/s2", ["CMS/SEC/SEC", "cm/s²", "cm per second squared", "cm/(s*s)", "cm_s2", "cms2"]),
        ("m/s2", ["m/s2", "M/S**2", "m/s/s", "m·s⁻²", "m s^-2", "m/sec^{2}", "m / s^2"]),
        ("mm/s2", ["mm/s2", "mm/s/s", "mm/sec^2"]),
    ],
)
def test_units_are_read_in_their_spellings(unit, spellings):
    assert {read_unit(text) for text in spellings} == {unit}
    assert not any(map(is_other_unit, spellings))


@pytest.mark.parametrize(
    "text",
    [
        *("cm/s", "mm", "in/s2", "%g", "ft/s^2", "counts", "mg"),
        *("cm/sec", "kine", "g/10", "0.1g", "m/s3", "m_s"),
    ],
)
def test_a_unit_in_which_no_acceleration_can_be_read_is_distinguished_from_a_word(text):
    assert read_unit(text) is None
    assert is_other_unit(text)
    assert not is_other_unit("NS")


@pytest.mark.parametrize(
    ("header", "unit", "dt"),
    [
        ("ACC.  UNIT: CM/SEC/SEC\nEQUALLY SPACED INTERVALS OF:  0.02  SEC\n", "cm/s2", 0.02),
        ("units: gal\ntime step 5 msec\n", "cm/s2", 0.005),
        ("The units are (g)\nSampling rate: 128 Hz\n", "g", 1 / 128),
        ("#AmplitudeUnit:  gal. DCoffset(corr)\n#SampleRate(Hz): 50\n", "cm/s2", 0.02),
        ("SAMPLING INTERVAL (ms) : 10\nAcceleration [m/s^2]\n", "m/s2", 0.01),
        ('"Unit","gal"\n"Sampling interval (ms)","5"\n', "cm/s2", 0.005),
        ("Acc/g, 40 points at 5 ms\n", "g", 0.005),
        ("fraction of g, sampled every 0.005 s\n", "g", 0.005),
        ("# g\nsampling 200 Hz, low-pass @ 25 Hz, FS = 2 g, delta = 0.5 deg\n", "g", 0.005),
        ("centimeters per second per second\nΔt=0.005s\n", "cm/s2", 0.005),
        ("Acceleration in cm s-2\nfs = 200 Hz\n", "cm/s2", 0.005),
        ("UNITS: cm / s^2\nsampling rate: 0.2 kHz\n", "cm/s2", 0.005),
        ("units: cm/(s^2)\nNPTS: 40\nDELTA: 0.02\n", "cm/s2", 0.02),
        ("# El Centro, m/s^2, dt 0.02 s, unscaled\n", "m/s2", 0.02),
    ],
)
def test_a_header_states_unit_and_sampling_period(read, refuses, header, unit, dt):
    record = read(header + ONE_COLUMN)
    assert stated(record) == (unit, pytest.approx(dt, rel=1e-12))
    assert "line" in record.channels[0]["unit_from"]
    other = "m/s2" if unit != "m/s2" else "g"
    refuses(f"unit is {other}, but .* says {unit}", header + ONE_COLUMN, unit=other)
    refuses(r"dt is 0.0123 s, but .* says", header + ONE_COLUMN, dt=0.0123)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("units: g\nacceleration in cm/s2\n", "line 2 states the unit cm/s2, but line 1 g"),
        ("dt=0.01\nSampling rate: 200 Hz\n", "line 2 states .* 0.005, but line 1 0.01"),
        ("NDATA: 40\n41 points\n", "line 2 states the number of points 41, but line 1 40"),
        ("units: counts\n", "counts is no acceleration unit"),
        ("TIMESERIES XX_ABC, 40 samples, 200 sps, SLIST, INTEGER, Counts\n", "Counts is no acc"),
        ("UNITS: g / 10\n", "g / 10 is no acceleration unit"),
        ("Acceleration in in/s2\n", "in/s2 is no acceleration unit"),
        ("Scale factor: 0.001\n", "line 1: states the factor 0.001"),
        ("UNITS ARE SEC AND G/10\n", "SEC is no acceleration unit"),
        ("Unit: furlong\n", 'states the unit "furlong", which is not known'),
        ("DATA_TYPE: VELOCITY\n", "line 1: holds a velocity"),
        ("COMP: NS  TYPE: VEL\n", "line 1: holds a velocity"),
        ("Tipo de datos: desplazamiento\n", "line 1: holds a displacement"),
        ("DATA_TYPE: ACCELERATION RESPONSE SPECTRUM\n", "line 1: holds a spectrum"),
        ("velocity (cm/s)\n", "line 1: holds a velocity"),
        ("Desplazamiento (cm) dt=0.01\n", "line 1: holds a displacement"),
        ("units: g\nSampling rate: 99,5 Hz\n", "line 2: write decimal points, not commas"),
    ],
)
def test_a_statement_that_can_not_be_used_is_refused_whatever_is_given(refuses, header, message):
    for words in ({}, {"unit": "cm/s2", "dt": 0.01}):
        refuses(message, header + ONE_COLUMN, **words)


def test_the_unit_of_a_peak_is_not_that_of_the_record(refuses):
    header = "Max. Acc. (gal)   5.4\nPGA 12 cm/s2, trigger 4 gal\ndt=0.01\n"
    refuses("does not say the unit", header + ONE_COLUMN)


@pytest.mark.parametrize(
    "words",
    [
        *("PGA = {:.2f} gal", "# PGA_CM/S^2: -{:.4f}", "Peak ground acceleration (cm/s^2) {:.1f}"),
        *("PEAK ACCELERATION = -{:.3f} CM/SEC/SEC AT 3.2 SEC", "Max. Acc. NS: {:.1f} gal"),
        *("acceleration: peak {:.2f} cm/s/s at 1 s", "UNCOR ACCEL  MAX = {:.2e} GAL"),
        *("Aceleración máxima: {:.1f} gal", "Amax={:.1f}gal, PGV=3 cm/s", "AccMax [gal], {:.1f}"),
        "PEAK VALUES : ACCEL=-{:.3f} CM/SEC/SEC  VELOCITY=-33.450 CM/SEC",
    ],
)
def test_a_peak_in_any_words_must_be_that_of_the_record(read, refuses, words):
    text = "{}\nunits: gal, dt=0.01\n" + ONE_COLUMN
    assert stated(read(text.format(words.format(0.9996)))) == ("cm/s2", 0.01)
    for wrong in (9.8, 0.1):
        refuses("line 1 states a peak of", text.format(words.format(wrong)))
    for other in ("trigger", "range", "horizontal", "vector"):  # not of this record
        read(text.format(f"{words.format(9.8)} {other}"))


@pytest.mark.parametrize("unit", ["mm/s2", "in/s2", "%g", "furlong"])
def test_a_unit_that_is_given_is_never_hinted_at_another(read, unit):
    with pytest.raises(InputError, match="must be g, m/s2, cm/s2 or gal; convert") as message:
        read(ONE_COLUMN, unit=unit, dt=0.01)
    assert "did you mean" not in str(message.value)


def table(*names, separator=","):
    """Columns with a time of 0.01 s first, then multiples of the wave."""
    numbers = range(1, len(names))
    rows = [[f"{0.01 * k:.2f}", *(f"{n * WAVE[k]:.5f}" for n in numbers)] for k in range(40)]
    return "\n".join(map(separator.join, [names, *rows])) + "\n"


@pytest.mark.parametrize(
    ("names", "column"),
    [
        (("time", "disp (cm)", "vel (cm/s)", "acc (cm/s2)"), 3),
        (("Time [s]", "Acceleration [gal]", "Velocity [m/s]"), 1),
        (("t", "force (N)", "a [cm/s^2]"), 2),
        (("time", "velocity", "acc_gal"), 2),
        (('"time, s"', '"disp, relative"', '"acc, absolute (gal)"'), 2),
    ],
)
def test_the_names_of_columns_choose_the_acceleration(read, names, column):
    record = read(table(*names))
    assert stated(record) == ("cm/s2", 0.01)
    assert record.channels[0]["column"].startswith(f"column {column} ")
    np.testing.assert_allclose(record.accelerations[:, 0], column * WAVE / 100, atol=1e-7)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (table("time", "vel (cm/s)"), 'column 1 "vel \\(cm/s\\)" .* is no acceleration'),
        (table("time", "acc (in/s2)"), "is no acceleration in a unit known here"),
        (table("time", "acc (0.1 g)"), "is no acceleration in a unit known here"),
        (table("s", "cm/s"), "is no acceleration in a unit known here"),
        (table("time", "displ"), "is no acceleration in a unit known here"),
        (table("T(s)", "PSA (gal)"), "is no acceleration in a unit known here"),
        (table("Period (s)", "PSA (gal)"), "PSA .gal. .line 1.: a spectrum, no time history"),
        (table("Frequency", "Amplitude"), "Amplitude .line 1.: a spectrum, no time history"),
        ("units: g\n" + table("time", "acc (gal)"), "line 1 states the unit g, but .* column cm/"),
        ("dt=0.02\n" + table("time", "acc (gal)"), "line 1 states .* 0.02, but column 0"),
    ],
)
def test_named_columns_that_are_no_acceleration_are_refused(refuses, text, message):
    for words in ({}, {"unit": "cm/s2"}, {"columns": [1], "unit": "cm/s2"}):
        refuses(message, text, **words)


@pytest.mark.parametrize(
    "names", ['"time (s)"\t"acc (gal)"', "time [s] acc[gal]", "Time (s)\tAcceleration (gal)"]
)
def test_names_stand_beside_their_units_in_any_columns(read, names):
    quoted = "\n".join(f'"{0.01 * k:.2f}"\t"{a:.5f}"' for k, a in enumerate(WAVE))
    text = quoted if '"' in names else quoted.replace('"', "")
    assert stated(read(f"{names}\n{text}\n")) == ("cm/s2", 0.01)


def test_the_words_of_a_sentence_are_no_names_of_columns(refuses):
    rows = "".join(f"{a:.5f} {2 * a:.5f} {3 * a:.5f} {4 * a:.5f}\n" for a in WAVE)
    for header in ("The units are (g)\n", "Kobe acceleration at JMA\n"):
        refuses("has 4 columns", header + rows, unit="g", dt=0.01)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-16-le", "latin-1", "shift-jis"])
def test_text_of_any_encoding_reads(read, encoding):
    station = "加速度" if encoding == "shift-jis" else "Orléans"
    text = f"{station}\n" + table("time", "acc (gal)")
    assert stated(read(text.encode(encoding))) == ("cm/s2", 0.01)


def test_a_csv_of_jma_reads_with_its_first_component(read):
    rows = "".join(f"{a:.3f},{2 * a:.3f},{3 * a:.3f}\r\n" for a in WAVE)
    text = (
        "SITE CODE= 名古屋\r\n SAMPLING RATE= 100Hz\r\n UNIT  = gal(cm/s/s)\r\nNS,EW,UD\r\n" + rows
    )
    record = read(text.encode("shift-jis"))
    assert stated(record) == ("cm/s2", 0.01)
    assert record.channels[0]["column"] == 'column 0 "NS"'


def timed(rate, decimals, count=120):
    """Times of a rate in Hz, rounded, and their values."""
    rows = (f"{k / rate:.{decimals}f},{WAVE[k % 40]:.5f}\n" for k in range(count))
    return "time (s),acc (g)\n" + "".join(rows)


@pytest.mark.parametrize(("rate", "decimals"), [(128, 3), (256, 3), (64, 3), (1024, 4)])
def test_times_that_are_even_before_they_were_rounded_are_even(read, refuses, rate, decimals):
    assert read(timed(rate, decimals)).dt == pytest.approx(1 / rate, rel=1e-12)
    assert read(timed(rate, decimals), dt=1 / rate).dt == 1 / rate
    refuses("resample the record evenly", timed(rate, decimals), dt=1.01 / rate)


def test_times_that_are_off_by_more_than_their_last_digit_are_uneven(refuses):
    text = timed(128, 3).replace("0.500,", "0.502,")
    assert "0.502," in text
    for dt in (0.0, 1 / 128):
        refuses(r"time goes from 0.\d+ to 0.\d+.*resample the record", text, dt=dt)


@pytest.mark.parametrize(
    "words",
    ["Scale factor: 0.001", "Conversion factor 0.001 gal/count", "Sensitivity 1000 counts/gal"],
)
def test_whole_numbers_with_a_factor_are_counts_whatever_the_unit(read, refuses, words):
    header = f"{words}\nunits: gal, dt=0.01\n"
    refuses("line 1: states the factor", header + "".join(f"{9000 * v:.0f}\n" for v in WAVE))
    assert stated(read(header + ONE_COLUMN)) == ("cm/s2", 0.01)


@pytest.mark.parametrize(("offset", "refused"), [(0.0, False), (0.015, False), (0.1, True)])
def test_an_offset_that_would_be_the_earthquake_is_refused(read, refuses, offset, refused):
    time = 0.01 * np.arange(2000)
    motion = np.sin(10 * time) * np.exp(-(((time - 6) / 3) ** 2))
    text = "acc (m/s2), dt=0.01\n" + "".join(f"{value:.6f}\n" for value in motion + offset)
    if refused:
        refuses(r"has an offset of 0.1\d* m/s2, .*--correct offset", text)
    corrected = read(text, corrected=refused).accelerations[:, 0]
    np.testing.assert_allclose(corrected, motion + offset, atol=1e-6)
