"""Machine code on the disk: who compiles hears so once, and others wait for it."""

import os
import subprocess
import sys

import numpy as np
import pytest
from seft_plant_sim import compiled as module
from seft_plant_sim.compiled import (
    compiled,
    dot,
    entry_point,
    is_at_hand,
    multiply,
    tell_of_compilation,
)


def double(x):
    return 2.0 * x


def triple(x):
    return 3.0 * x


def test_the_first_compilation_of_a_process_is_reported_and_none_on_disk(monkeypatch, tmp_path):
    if module.numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(module, "code_folder", lambda _: tmp_path)
    heard = []
    tell_of_compilation(lambda: heard.append("compiling"))
    assert (compiled(double)(4.0), compiled(triple)(4.0)) == (8.0, 12.0)
    assert heard == ["compiling"]
    tell_of_compilation(lambda: heard.append("once more"))
    assert compiled(double)(4.0) == 8.0
    assert heard == ["compiling"]


def test_with_numba_switched_off_the_steps_stay_what_they_are(monkeypatch):
    monkeypatch.setattr(module.numba.config, "DISABLE_JIT", 1)
    assert entry_point(double, 4.0) is compiled(double) is double
    assert not is_at_hand(double, 4.0)


COMPILES_A_FUNCTION = """
import sys
import numpy as np
from seft_plant_sim.compiled import copy, entry_point, tell_of_compilation
tell_of_compilation(lambda: print("compiled here", flush=True))
print("begin", flush=True)
sys.stdin.readline()
entry_point(copy, 1, np.zeros(1), np.zeros(1))
"""


def test_of_processes_that_need_the_same_code_at_the_same_time_one_compiles(tmp_path):
    run = [sys.executable, "-c", COMPILES_A_FUNCTION]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    paths = {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": os.pathsep.join(sys.path)}
    begun = [subprocess.Popen(run, env=os.environ | paths, **pipes) for _ in range(2)]
    for process in begun:
        assert process.stdout.readline() == "begin\n"
    for process in begun:
        process.stdin.write("\n")
        process.stdin.flush()
    heard = [process.communicate()[0] for process in begun]
    assert sorted(heard) == ["", "compiled here\n"]


@pytest.mark.parametrize("size", range(10))
def test_sums_of_products_are_those_of_numpy_for_each_size(size):
    rng, result = np.random.default_rng(size), np.empty(7)
    matrix, vector = rng.standard_normal((size, 7)), rng.standard_normal(size + 1)
    multiply(matrix, vector[:size], result)
    np.testing.assert_allclose(result, vector[:size] @ matrix, rtol=1e-13, atol=1e-14)
    assert dot(size, vector, vector) == pytest.approx(vector[:size] @ vector[:size], rel=1e-14)
