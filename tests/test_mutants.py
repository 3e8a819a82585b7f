"""The mutation tests run (tools/mutants.py): they take too long to be run here."""

import os
import subprocess
import sys

from graph_tools import ROOT

ONE_MUTANT = """
import ast, importlib, mutants
for module in mutants.LIBRARIES:
    importlib.import_module(module)
(name, tests), *_ = mutants.TESTS.items()
tree = ast.parse((mutants.HOME / name).read_text())
print(mutants.is_killed(mutants.HOME / name, tree, tests, 60.0))
_, mutant = next(mutants.mutants(tree))
print(mutants.is_killed(mutants.HOME / name, mutant, tests, 60.0))
"""


def test_a_file_passes_its_fast_tests_uncompiled_and_its_first_mutant_fails():
    done = subprocess.run(
        [sys.executable, "-c", ONE_MUTANT],
        cwd=ROOT,
        env=os.environ | {"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT / "tools")},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["False", "True"]
