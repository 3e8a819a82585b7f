"""Machine code on the disk: who compiles is told so once."""

import pytest
from seft_plant_sim import compiled as module
from seft_plant_sim.compiled import compiled, tell_of_compilation


def double(x):
    return 2.0 * x


def triple(x):
    return 3.0 * x


def test_the_first_compilation_of_a_process_is_told_and_none_of_what_is_on_the_disk(
    monkeypatch, tmp_path
):
    if module.numba.config.DISABLE_JIT:
        pytest.skip("nothing is compiled")
    monkeypatch.setattr(module, "code_folder", lambda _: tmp_path)
    told = []
    tell_of_compilation(lambda: told.append("compiling"))
    assert (compiled(double)(4.0), compiled(triple)(4.0)) == (8.0, 12.0)
    assert told == ["compiling"]
    tell_of_compilation(lambda: told.append("once more"))
    assert compiled(double)(4.0) == 8.0
    assert told == ["compiling"]
