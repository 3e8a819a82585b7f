"""Table of detectors.md: faults of the hardware in tests of other specimens; run in the project.

    .venv/bin/python docs/faults.py kobe.txt

kobe.txt is Kobe 1995, JMA N-S, in cm/s^2 at 0.005 s (yours to bring). Without it the synthetic
motion is all there is.
"""

import sys

sys.path.append("src/seft_ros/test")

from rig_faults import FAULTS
from test_detectors import BILINEAR, GAP, PLAN, SPECIMEN, sound, with_fault

FRICTION = ("rig:specimen.kind:=friction", f"{SPECIMEN}friction.force:=60.0")
TESTS = {"linear": (), "bilinear": BILINEAR, "gap": GAP, "friction": FRICTION}
TIMES = 2.0, 3.5, 5.0


def main() -> None:
    """Print the table."""
    motions = {"synthetic": ()}
    if len(sys.argv) > 1:
        file, unit, dt = f"file:={sys.argv[1]}", "unit:=cm/s2", "dt:=0.005"
        motions["Kobe"] = tuple(f"ground_motion:{word}" for word in (file, unit, dt))
    print("| specimen, motion, fault at | in time | late or not seen | force above 1.5 peaks |")
    print("|---|---|---|---|")
    for specimen, words in TESTS.items():
        for motion, record in motions.items():
            for time in TIMES:
                given = (*PLAN, *words, *record)
                dt, largest = sound(given)[0].timebase.dt, sound(given)[2]
                late, hard, right = [], [], 0
                for fault in FAULTS:
                    _, rig, is_right = with_fault(fault, given, round(time / dt))
                    right += is_right
                    gentle = rig.peak_force <= 1.5 * largest[3]
                    if not is_right:
                        (late if gentle else hard).append(fault)
                cells = f"{right} of {len(FAULTS)}", ", ".join(late), ", ".join(hard)
                print(f"| {specimen}, {motion}, {time:g} s | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
