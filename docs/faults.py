"""Table of safety.md: faults of the hardware in tests of other specimens; run in the project.

    .venv/bin/python docs/faults.py kobe.txt:cm/s2:0.005:0

Each motion is FILE, or FILE:UNIT:DT:COLUMN (yours to bring; kobe.txt is Kobe 1995, JMA N-S), beside
the synthetic one.
"""

import sys
from collections import Counter

sys.path.append("src/seft_ros/test")

from rig_faults import FAULTS
from sound_tests import motion_words
from test_detectors import (
    BILINEAR,
    GAP,
    HARD,
    HARMLESS,
    IN_TIME,
    PLAN,
    SPECIMEN,
    TOO_LATE,
    sound,
    with_fault,
)

FRICTION = ("rig:specimen.kind:=friction", f"{SPECIMEN}friction.force:=60.0")
TESTS = {"linear": (), "bilinear": BILINEAR, "gap": GAP, "friction": FRICTION}
TIMES = 2.0, 3.5, 5.0


def main() -> None:
    """Print the table."""
    motions = {"synthetic": ()} | {
        word.partition(":")[0]: motion_words(word) for word in sys.argv[1:]
    }
    tests = [(motion, time) for motion in motions for time in TIMES]
    heads = "".join(f" {motion}, {time:g} s |" for motion, time in tests)
    print(f"| of {len(FAULTS)} faults: in time + harmless |{heads}\n|---|{'---|' * len(tests)}")
    found = {verdict: Counter() for verdict in (TOO_LATE, HARD, HARMLESS)}
    for specimen, words in TESTS.items():
        cells = []
        for motion, time in tests:
            given = (*PLAN, *words, *motions[motion])
            at = round(time / sound(given)[0].timebase.dt)
            verdicts = {fault: with_fault(fault, given, at)[1] for fault in FAULTS}
            count = Counter(verdicts.values())
            cells.append(f" {count[IN_TIME]} + {count[HARMLESS]} |")
            for verdict, faults in found.items():
                faults.update(fault for fault, own in verdicts.items() if own == verdict)
        print(f"| {specimen} |{''.join(cells)}", flush=True)
    words = "late or not seen", "force above 1.5 peaks", "nothing changes"
    for what, faults in zip(words, found.values(), strict=True):
        names = ", ".join(f"{fault} {count}" for fault, count in faults.most_common())
        print(f"\n{what}, in so many of {len(TESTS) * len(tests)} tests: {names}")


if __name__ == "__main__":
    main()
