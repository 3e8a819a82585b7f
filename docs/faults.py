"""Table of detectors.md: faults of the hardware in tests of other specimens; run in the project.

    .venv/bin/python docs/faults.py kobe.txt

kobe.txt is Kobe 1995, JMA N-S, in cm/s^2 at 0.005 s (yours to bring). Without it the synthetic
motion is all there is.
"""

import sys
from collections import Counter

sys.path.append("src/seft_ros/test")

from rig_faults import FAULTS
from test_detectors import BILINEAR, GAP, LARGEST, PLAN, SPECIMEN, sound, with_fault

FRICTION = ("rig:specimen.kind:=friction", f"{SPECIMEN}friction.force:=60.0")
TESTS = {"linear": (), "bilinear": BILINEAR, "gap": GAP, "friction": FRICTION}
TIMES = 2.0, 3.5, 5.0


def main() -> None:
    """Print the table."""
    motions = {"synthetic": ()}
    if len(sys.argv) > 1:
        file, unit, dt = f"file:={sys.argv[1]}", "unit:=cm/s2", "dt:=0.005"
        motions["Kobe"] = tuple(f"ground_motion:{word}" for word in (file, unit, dt))
    tests = [(motion, time) for motion in motions for time in TIMES]
    heads = "".join(f" {motion}, {time:g} s |" for motion, time in tests)
    print(f"| faults in time, of {len(FAULTS)} |{heads}\n|---|{'---|' * len(tests)}")
    late, hard = Counter(), Counter()
    for specimen, words in TESTS.items():
        cells = []
        for motion, time in tests:
            given = (*PLAN, *words, *motions[motion])
            dt, largest = sound(given)[0].timebase.dt, sound(given)[2]
            missed = 0
            for fault in FAULTS:
                _, rig, is_right = with_fault(fault, given, round(time / dt))
                missed += not is_right
                is_hard = rig.peak_force > LARGEST * largest[3]
                if not is_right:
                    (hard if is_hard else late).update([fault])
            cells.append(f" {len(FAULTS) - missed} |")
        print(f"| {specimen} |{''.join(cells)}", flush=True)
    for what, found in (("late or not seen", late), ("force above 1.5 peaks", hard)):
        names = ", ".join(f"{fault} {count}" for fault, count in found.most_common())
        print(f"\n{what}, in so many of {len(TESTS) * len(tests)} tests: {names}")


if __name__ == "__main__":
    main()
