"""The mutation tests can begin (tools/mutants.py): they take too long to be run here."""

import os
import subprocess
import sys

import pytest
from graph_tools import ROOT, THOROUGH

BEGINNING = """
import ast, importlib, mutants
for module in mutants.LIBRARIES:
    importlib.import_module(module)

def passes(name, tree):
    killed = mutants.is_killed(mutants.HOME / name, tree, mutants.TESTS[name], 600.0)
    return "fails" if killed else "passes"

trees = {name: ast.parse((mutants.HOME / name).read_text()) for name in mutants.TESTS}
for name in {tests: name for name, tests in mutants.TESTS.items()}.values():
    print(name, passes(name, trees[name]))
name = next(iter(trees))
_, mutant = next(mutants.mutants(trees[name]))
print("mutant", passes(name, mutant))
"""


@THOROUGH
@pytest.mark.offline
def test_every_file_passes_its_fast_tests_uncompiled_and_a_mutant_fails():
    done = subprocess.run(
        [sys.executable, "-c", BEGINNING],
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT / "tools")},
        capture_output=True,
        text=True,
        check=True,
    )
    *files, mutant = done.stdout.splitlines()
    assert [each for each in files if not each.endswith(" passes")] == []
    assert mutant == "mutant fails"
