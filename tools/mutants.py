"""Mutation tests of the protection layer: list the changes of its code that no test notices.

Each mutant is one change of one file, made as the file is imported: the files stay as they are. It
runs in a process of its own, in which numba compiles nothing, on the fast tests of that file.
Killed mutants are kept in build/mutants.txt, and not run again while the file stays as it is.
"""

import argparse
import ast
import contextlib
import copy
import gc
import hashlib
import importlib
import importlib.machinery
import os
import signal
import sys
import time
from functools import partial
from pathlib import Path

HOME = Path(__file__).parents[1]
KILLED = HOME / "build" / "mutants.txt"
PLANT, ROS = "src/seft_plant_sim/", "src/seft_ros/"
PROTECTION, CONTROL = f"{ROS}seft_ros/protection/", f"{ROS}seft_ros/force_controller/"
JUDGE = f"{PLANT}seft_plant_sim/judge/"
GUARD_TESTS = (f"{PLANT}test/test_judge_guard.py", f"{PLANT}test/test_rig.py")
DETECTOR_TESTS = tuple(
    f"{PLANT}test/test_judge_{name}.py" for name in ("detectors", "relations", "specimen_force")
)
CONTROL_TESTS = (
    f"{ROS}test/test_force_controller_interlock.py",
    f"{ROS}test/test_force_controller_stop.py",
    "-knot offline_loop",
)
FOLLOWER_TESTS = (
    f"{ROS}test/test_force_controller_force_control.py",
    f"{ROS}test/test_velocity_feedforward.py",
    *CONTROL_TESTS,
)
FORCE_TESTS = tuple(
    f"{ROS}test/test_protection_{name}.py"
    for name in ("protected_force", "plausibility", "ramp_down")
)
WATCH_TESTS = (f"{ROS}test/test_protection_instability.py",)
TESTS = {
    f"{PLANT}seft_plant_sim/limits.py": (f"{PLANT}test/test_limits.py",),
    f"{PLANT}seft_plant_sim/rig_watch.py": (f"{PLANT}test/test_rig_watch.py",),
    f"{PLANT}seft_plant_sim/command.py": (f"{PLANT}test/test_command.py",),
    "src/seft_msgs_py/seft_msgs_py/node/senders.py": ("src/seft_msgs_py/test/test_senders.py",),
    f"{CONTROL}interlock.py": CONTROL_TESTS,
    f"{CONTROL}target_distance.py": (f"{ROS}test/test_force_controller_target_distance.py",),
    f"{CONTROL}force_control.py": FOLLOWER_TESTS,
    f"{PROTECTION}protected_force.py": (*FORCE_TESTS, *CONTROL_TESTS),
    **{
        f"{JUDGE}{name}.py": DETECTOR_TESTS
        for name in (
            *("detectors", "detector_list", "channel_relations", "relation_following"),
            *("specimen_force", "valve_following"),
        )
    },
    **{
        f"{JUDGE}{name}.py": (f"{PLANT}test/test_judge.py", *DETECTOR_TESTS)
        for name in ("judge", "judge_step")
    },
    f"{JUDGE}detector_step.py": (*DETECTOR_TESTS, *GUARD_TESTS),
    f"{JUDGE}guard.py": GUARD_TESTS,
    f"{PROTECTION}instability.py": (*FORCE_TESTS, *WATCH_TESTS),
}
SWAPS = {
    **{ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt)},
    **{ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,)},
    **{ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,)},
    **{ast.Or: (ast.And,), ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,)},
    **{ast.Div: (ast.Mult,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,)},
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}
LIBRARIES = ("hypothesis", "numba", "pytest", "rosbags.typesys", "scipy.signal")
WORDS = (
    "-qx",
    "--hypothesis-seed=0",
    "--assert=plain",
    "-Wignore::RuntimeWarning",  # compiled arithmetic does not warn
    *(f"-pno:{each}" for each in ("cacheprovider", "pytest_cov", "xdist")),
)
ACTS = (ast.AugAssign, ast.Expr, ast.Raise, ast.Return, ast.Continue, ast.Break)


def changes(node):
    """Give what may stand in for a node."""
    if isinstance(node, ast.Compare):
        for swap in SWAPS.get(type(node.ops[0]), ()):
            yield ast.Compare(node.left, [swap(), *node.ops[1:]], node.comparators)
    elif isinstance(node, ast.BoolOp | ast.BinOp | ast.AugAssign):
        for swap in SWAPS.get(type(node.op), ()):
            yield changed(node, op=swap())
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    elif isinstance(node, ast.If | ast.IfExp | ast.While):
        if not isinstance(node.test, ast.Compare | ast.UnaryOp):  # these change by themselves
            yield changed(node, test=ast.UnaryOp(ast.Not(), node.test))
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node, ast.Constant) and isinstance(node.value, int | float):
        yield ast.Constant(2 * node.value + (not node.value % 2))
    elif isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id in NAMES:
            yield changed(node, func=ast.Name(NAMES[node.func.id], ast.Load()))
        elif node.func.id == "abs":
            yield node.args[0]
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    places = [*ast.walk(node.targets[0])] if isinstance(node, ast.Assign) else []
    is_kept = any(isinstance(each, ast.Attribute | ast.Subscript) for each in places)
    if is_kept or (isinstance(node, ACTS) and not is_text):
        yield ast.Pass()


def changed(node, **fields):
    """Give a copy of a node with other fields."""
    other = copy.copy(node)
    vars(other).update(fields)
    return other


def mutants(tree):
    """Give the name of each mutant of a module, which begins with its line, and the module."""
    for node in ast.walk(tree):
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            is_list = isinstance(value, list)
            for index, child in enumerate(value if is_list else [value]):
                put = (
                    partial(value.__setitem__, index) if is_list else partial(setattr, node, field)
                )
                for other in changes(child) if isinstance(child, ast.AST) else ():
                    ast.fix_missing_locations(ast.copy_location(other, child))
                    old, new = (ast.unparse(each).partition("\n")[0] for each in (child, other))
                    put(other)
                    yield f"{child.lineno}:{child.col_offset} {old}  ->  {new}", tree
                    put(child)


class Uncompiled:
    """A plugin of pytest: steps run as Python, and what hypothesis finds is not made smaller."""

    def pytest_collection(self):
        """Begin, once the settings of all tests are known."""
        from hypothesis import Phase, settings

        phases, seft = [Phase.explicit, Phase.generate], settings.get_profile("seft")
        settings.register_profile("mutants", seft, phases=phases, database=None)
        settings.load_profile("mutants")


def is_killed(file, tree, tests, longest):
    """Run tests on a changed module in a process of their own; say whether one notices."""
    began, child = time.monotonic(), os.fork()
    if not child:
        os.setsid()
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        load = importlib.machinery.SourceFileLoader.get_code

        def get_code(self, name):
            is_it = Path(self.path).resolve() == file
            return compile(tree, str(file), "exec") if is_it else load(self, name)

        importlib.machinery.SourceFileLoader.get_code = get_code
        import pytest

        with contextlib.suppress(BaseException):
            os._exit(int(pytest.main([*WORDS, *tests], plugins=[Uncompiled()])))
        os._exit(1)
    while not (ended := os.waitpid(child, os.WNOHANG))[0]:
        if time.monotonic() - began > longest:
            os.killpg(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return True
        time.sleep(0.005)
    return ended[1] != 0


def main():
    """Run the mutants of some files, or all."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("words", nargs="*", help="parts of the files' paths; default all")
    words = parser.parse_args().words
    os.chdir(HOME)
    os.environ.update(NUMBA_DISABLE_JIT="1")
    for module in LIBRARIES:  # once, and not in each process
        importlib.import_module(module)
    gc.freeze()
    KILLED.parent.mkdir(exist_ok=True)
    KILLED.touch()
    total = survived = 0
    for name, tests in TESTS.items():
        if not words or any(word in name for word in words):
            every, left = survivors(name, tests)
            print(f"{name}: {every} mutants, {len(left)} survive", *left, sep="\n  ", flush=True)
            total, survived = total + every, survived + len(left)
    print(f"{total} mutants, {total - survived} killed, {survived} survive")


def survivors(name, tests):
    """Run the mutants of a file; give how many there are, and which survive, by their lines."""
    file, began, left = HOME / name, time.monotonic(), []
    text, known = file.read_bytes(), set(KILLED.read_text().splitlines())
    key, tree = hashlib.sha256(text).hexdigest()[:16], ast.parse(text)
    if is_killed(file, tree, tests, 600.0):
        sys.exit(f"{name}: its tests fail without any change: {' '.join(tests)}")
    longest, every = 5.0 + 5.0 * (time.monotonic() - began), sum(1 for _ in mutants(tree))
    for count, (mutant, mutated) in enumerate(mutants(tree), 1):
        if sys.stderr.isatty():
            where = f"\r{name} {count}/{every}, {len(left)} survive\033[K"
            print(where, end="\r" * (count == every), file=sys.stderr, flush=True)
        if (line := f"{key} {mutant}") in known:
            continue
        if is_killed(file, mutated, tests, longest):
            with KILLED.open("a") as killed:
                print(line, file=killed)
        else:
            left.append(mutant)
    return every, sorted(left, key=lambda mutant: int(mutant.partition(":")[0]))


if __name__ == "__main__":
    main()
