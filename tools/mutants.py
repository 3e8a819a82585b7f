"""Mutation tests of the protection layer: list the changes of its code that no test notices.

Each mutant is one change of one file, made as the file is imported: the files stay as they are. It
runs in a process of its own, in which numba compiles nothing, on the fast tests of that file.
Killed mutants are kept in build/mutants.txt, and not run again while the file stays as it is.
"""

import argparse
import ast
import contextlib
import copy
import hashlib
import importlib.machinery
import os
import signal
import sys
import time
from pathlib import Path

HOME = Path(__file__).parents[1]
KILLED = HOME / "build" / "mutants.txt"
PLANT, ROS = "src/seft_plant_sim/", "src/seft_ros/"
LOCK, CONTROL = f"{ROS}seft_ros/interlock/", f"{ROS}seft_ros/force_controller/"
DETECTOR_TESTS = (f"{ROS}test/test_interlock_detectors.py",)
CONTROL_TESTS = (f"{ROS}test/test_force_controller_interlock.py", "-knot offline_loop")
FORCE_TESTS = (f"{ROS}test/test_interlock_protected_force.py",)
DRIVER = f"{ROS}seft_ros/cli/templates/rig_driver/rig_driver/"
DRIVER_TESTS = ("tests/test_driver_faults.py", "-knot hardware")
WATCH_TESTS = (*FORCE_TESTS, f"{ROS}test/test_interlock_instability.py")
TESTS = {
    f"{PLANT}seft_plant_sim/limits.py": (f"{PLANT}test/test_limits.py",),
    f"{PLANT}seft_plant_sim/rig_watch.py": (f"{PLANT}test/test_rig_watch.py",),
    f"{PLANT}seft_plant_sim/command.py": (f"{PLANT}test/test_command.py",),
    "src/seft_msgs_py/seft_msgs_py/node/senders.py": ("src/seft_msgs_py/test/test_senders.py",),
    f"{CONTROL}interlock_step.py": CONTROL_TESTS,
    f"{CONTROL}interlock.py": CONTROL_TESTS,
    f"{CONTROL}silence.py": CONTROL_TESTS,
    f"{CONTROL}detectors_of.py": CONTROL_TESTS,
    f"{LOCK}ramp_down.py": (f"{ROS}test/test_interlock_ramp_down.py",),
    f"{LOCK}plausibility.py": (f"{ROS}test/test_interlock_plausibility.py",),
    f"{LOCK}protection.py": FORCE_TESTS,
    f"{LOCK}protected_force.py": FORCE_TESTS,
    **{
        f"{LOCK}{name}.py": DETECTOR_TESTS
        for name in (
            *("detector_look", "detector_step", "specimen_detectors", "valve_following"),
            *("detector_arrays", "detectors"),
        )
    },
    f"{DRIVER}safe_stop.py": DRIVER_TESTS,
    f"{DRIVER}rest.py": DRIVER_TESTS,
    f"{LOCK}watch_step.py": WATCH_TESTS,
    f"{LOCK}instability.py": WATCH_TESTS,
}
SWAPS = {
    **{ast.Lt: (ast.LtE, ast.Gt), ast.LtE: (ast.Lt, ast.Gt), ast.Gt: (ast.GtE, ast.Lt)},
    **{ast.GtE: (ast.Gt, ast.Lt), ast.Eq: (ast.NotEq,), ast.NotEq: (ast.Eq,), ast.Is: (ast.IsNot,)},
    **{ast.IsNot: (ast.Is,), ast.In: (ast.NotIn,), ast.NotIn: (ast.In,), ast.And: (ast.Or,)},
    **{ast.Or: (ast.And,), ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,)},
    **{ast.Div: (ast.Mult,), ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd,)},
}
NAMES = {"min": "max", "max": "min", "any": "all", "all": "any"}
ACTS = (ast.AugAssign, ast.Expr, ast.Raise, ast.Return, ast.Continue, ast.Break)


def changes(node):
    """Give what may stand in for a node."""
    if isinstance(node, ast.Compare | ast.BoolOp | ast.BinOp | ast.AugAssign):
        place = node.ops[0] if isinstance(node, ast.Compare) else node.op
        for swap in SWAPS.get(type(place), ()):
            other = copy.copy(node)
            setattr(
                other, *(("ops", [swap()]) if isinstance(node, ast.Compare) else ("op", swap()))
            )
            yield other
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not | ast.USub):
        yield node.operand
    if isinstance(node, ast.If | ast.IfExp | ast.While) and not isinstance(
        node.test, ast.Compare | ast.UnaryOp
    ):
        other = copy.copy(node)
        other.test = ast.UnaryOp(ast.Not(), node.test)
        yield other
    if isinstance(node, ast.Constant) and isinstance(node.value, bool | int | float):
        value = node.value
        yield ast.Constant(not value if isinstance(value, bool) else 2 * value + (not value % 2))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
        if node.func.id in NAMES:
            yield ast.Call(ast.Name(NAMES[node.func.id], ast.Load()), node.args, node.keywords)
        elif node.func.id == "abs":
            yield node.args[0]
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    places = [*ast.walk(node.targets[0])] if isinstance(node, ast.Assign) else []
    if (isinstance(node, ACTS) and not is_text) or any(
        isinstance(each, ast.Attribute | ast.Subscript) for each in places
    ):
        yield ast.Pass()


def mutants(tree):
    """Give each change of a module: the name of the mutant, its line, and the changed module."""
    for node in ast.walk(tree):
        for field, value in ast.iter_fields(node):
            if field in ("annotation", "returns", "decorator_list"):
                continue
            for index, child in enumerate(value if isinstance(value, list) else [value]):
                for other in changes(child) if isinstance(child, ast.AST) else ():
                    ast.fix_missing_locations(ast.copy_location(other, child))
                    old, new = (ast.unparse(each).partition("\n")[0] for each in (child, other))
                    if isinstance(value, list):
                        value[index] = other
                    else:
                        setattr(node, field, other)
                    yield f"{child.lineno}:{child.col_offset} {old}  ->  {new}", tree
                    if isinstance(value, list):
                        value[index] = child
                    else:
                        setattr(node, field, child)


class Uncompiled:
    """A plugin of pytest: steps run as Python, and what hypothesis finds is not made smaller."""

    def pytest_collection(self):
        """Begin, once the settings of all tests are known."""
        from hypothesis import Phase, settings
        from seft_plant_sim import compiled

        compiled.entry_point = lambda function, *_, **__: function
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

        words = [
            "-qx",
            "-pno:cacheprovider",
            "--assert=plain",
            "--hypothesis-seed=0",
            *map(str, tests),
        ]
        with contextlib.suppress(BaseException):
            os._exit(int(pytest.main(words, plugins=[Uncompiled()])))
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
    import hypothesis  # noqa: F401
    import numba  # noqa: F401
    import pytest  # noqa: F401
    import scipy.signal  # noqa: F401

    KILLED.parent.mkdir(exist_ok=True)
    KILLED.touch()
    survived = total = 0
    for name, tests in TESTS.items():
        if words and not any(word in name for word in words):
            continue
        file = HOME / name
        text = file.read_bytes()
        key = hashlib.sha256(text).hexdigest()[:16]
        known, began = set(KILLED.read_text().splitlines()), time.monotonic()
        tree = ast.parse(text)
        if is_killed(file, tree, tests, 600.0):
            sys.exit(f"{name}: its tests fail without any change: {' '.join(tests)}")
        longest = 5.0 + 5.0 * (time.monotonic() - began)
        every, left = sum(1 for _ in mutants(tree)), []
        for count, (mutant, changed) in enumerate(mutants(tree), 1):
            if sys.stderr.isatty():
                print(
                    f"\r{name} {count}/{every}, {len(left)} survive\033[K", end="", file=sys.stderr
                )
            if (line := f"{key} {mutant}") in known:
                continue
            if is_killed(file, changed, tests, longest):
                with KILLED.open("a") as kept:
                    kept.write(f"{line}\n")
            else:
                left.append(mutant)
        print(f"\r{name}: {every} mutants, {len(left)} survive\033[K")
        print(
            *(f"  {mutant}" for mutant in sorted(left, key=lambda m: int(m.split(":")[0]))),
            sep="\n",
        )
        total, survived = total + every, survived + len(left)
        sys.stdout.flush()
    print(f"{total} mutants, {total - survived} killed, {survived} survive")


if __name__ == "__main__":
    main()
