"""Turns of a process of nodes."""

import subprocess
import sys

PROGRAM = """
from seft_msgs_py.node.node_process import NodeProcess
process = NodeProcess([], ["somebody"])
called = []
process.every_turn(lambda: called.append("look"))
process.now_and_then(lambda: called.append("chore"))
process.spin_once(0.0)
for _ in range(50):
    process.spin_once(0.0)
print(called.count("look"), called.count("chore"))
process.spin_once(0.06)
print(called.count("look"), called.count("chore"))
process.close()
"""


def test_a_look_is_taken_after_each_turn_and_chores_are_done_now_and_then():
    done = subprocess.run([sys.executable, "-c", PROGRAM], stdout=subprocess.PIPE, check=True)
    looks, chores, more_looks, more_chores = map(int, done.stdout.split())
    assert (looks, more_looks) == (51, 52)
    assert 1 <= chores < 25
    assert more_chores == chores + 1
