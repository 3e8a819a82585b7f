"""Table of rig.md, section What is known of them: run it in the folder of the project.

    .venv/bin/python docs/sensors.py kobe.txt:cm/s2:0.005:0

Errors of the true displacement in percent, of the specimens of `LAWS`: nothing known of the
sensors, told what they do, and as identified. The motion is FILE:UNIT:DT:COLUMN (yours to bring),
or the synthetic one, which shakes the three storeys in any case.
"""

import sys

sys.path.append("src/seft_ros/test")

from fault_free_tests import motion_words
from test_detectors import BILINEAR, GAP, KIND, PLAN, SPECIMEN
from trust import SENSORS, STOREYS, identified_of, run

LAWS = (), BILINEAR, (f"{KIND}friction", f"{SPECIMEN}friction.force:=60.0"), GAP
CHANNELS = {
    "without errors": (),
    "acceleration late by 1 ms": ("acceleration_lag:=0.001",),
    "force late by 3 ms": ("force_lag:=0.002995",),
    "filter of 60 Hz on the displacement": ("displacement_filter:=60.0",),
    "filter of 60 Hz on the acceleration": ("acceleration_filter:=60.0",),
    "filter of 60 Hz on the force": ("force_filter:=60.0",),
}
TILT = ("tilt:=[1.0, 0.03, -0.02, 0.04, 1.0, 0.03, -0.03, 0.02, 1.0]",)


def percent(words, axes):
    """Error of a test; T: it trips."""
    error = run(words, axes)[1]
    return "T" if error is None else f"{100 * error:.1g}" if error < 0.01 else f"{100 * error:.2g}"


def cells(words, sensors, axes):
    """Errors if nothing is known, told, and identified."""
    true = (*words, *(f"{SENSORS}{word}" for word in sensors))
    told = (f"calibration.{word}" for word in sensors)
    tests = (), told, identified_of(true, axes, ())
    return ", ".join(percent((*true, *known), axes) for known in tests)


def main():
    """Print the table."""
    motion = motion_words(sys.argv[1]) if len(sys.argv) > 1 else ()
    for name, sensors in CHANNELS.items():
        found = (cells((*PLAN, *motion, *law), sensors, 1) for law in LAWS)
        print(f"| {name} | {' | '.join(found)} |", flush=True)
    for name, sensors in {"without errors": (), "tilt of 2 to 4 %": TILT}.items():
        found = (cells(law, sensors, 3) for law in ((), (*BILINEAR, STOREYS)))
        print(f"| three storeys, {name} | {' | '.join(found)} | | |", flush=True)


if __name__ == "__main__":
    main()
