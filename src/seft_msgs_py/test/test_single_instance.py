"""A node's name is taken once, and free again however its holder ends."""

import os
import subprocess
import sys

import pytest
from seft_msgs_py.errors import InputError
from seft_msgs_py.node.middleware import is_running, single_instance

NODE = f"/test_{os.getpid()}/rig"


def test_a_name_is_taken_once_on_a_domain():
    held = single_instance(7, NODE)
    with pytest.raises(InputError, match=f"domain 7 already has a node {NODE} on this host"):
        single_instance(7, NODE)
    assert is_running(7, NODE)
    assert not is_running(8, NODE)
    assert not is_running(7, f"{NODE}_2")
    held.close()
    assert not is_running(7, NODE)


def test_the_name_of_a_killed_process_is_free():
    program = (
        "import time; from seft_msgs_py.node.middleware import single_instance; "
        f"held = single_instance(7, {NODE!r}); print('held', flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        assert process.stdout.readline() == b"held\n"
        assert is_running(7, NODE)
        process.kill()
        process.wait()
    assert not is_running(7, NODE)
