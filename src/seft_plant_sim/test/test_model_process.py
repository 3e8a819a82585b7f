"""Models that misbehave: one clear line, nothing on stdout, and no process is left."""

import re
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from seft_plant_sim.computed import model_process
from seft_plant_sim.computed.computed_model import ComputedModel, ModelError, ModelSource

MODEL = """
import os, signal, sys, threading, time


class Model:
    axes = 1

    def start(self, dt, axes):
        self.count = 0

    def step(self, t, displacement, velocity, ground_acceleration):
        self.count += 1
        if self.count > 2:
            pass
            # STEP
        return 1e4 * displacement

    # MORE
"""
PLACES = {"STEP": 12, "MORE": 4}
ZERO, LAST = np.zeros(1), 5


@pytest.fixture
def model(tmp_path):
    """Write a model that does something at a place; give its source."""
    file = tmp_path / "models.py"

    def source(code, place="STEP"):
        code = textwrap.indent(textwrap.dedent(code).strip(), " " * PLACES[place])
        file.write_text(MODEL.replace(" " * PLACES[place] + f"# {place}", code))
        return ModelSource(f"{file}:Model", "", ("x",), np.eye(1), 1, np.eye(1))

    return source


def run(source):
    """Take some steps; give the force of the last one, and what went wrong."""
    model = None
    try:
        model = ComputedModel(source)
        started = model.start(0.002)
        assert (started.force == 0.0).all()
        for step in range(LAST + 1):
            found = model.step(0.002 * step, np.array([1e-3 * step]), ZERO, ZERO)
    except ModelError as error:
        return None, str(error)
    finally:
        if model is not None:
            model.close()
    return float(found.force[0]), ""


def of_models(file):
    """Find the processes that show this file in their command lines."""
    found = []
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            if str(file) in (entry / "cmdline").read_text():
                found.append(entry.name)
        except OSError:
            continue
    return found


def nothing_left(source):
    while of_models(source.name):  # a test that hangs tells which model is left
        time.sleep(0.01)
    return True


BREAKS = {
    "exits": ("sys.exit(0)", r"line 15, step: SystemExit\(0\)"),
    "ends at once": ("os._exit(3)", "step: its process has ended with exit status 3"),
    "crashes": (
        "import ctypes; ctypes.string_at(0)",
        "step: its process was ended by SIGSEGV at models.py line 15",
    ),
    "hangs": ("while True: pass", "step: no answer within 1 s at models.py line 15"),
    "hangs and hears no signals": (
        """
        for number in set(signal.Signals) - {signal.SIGKILL, signal.SIGSTOP}:
            signal.signal(number, signal.SIG_IGN)
        time.sleep(1e6)
        """,
        "step: no answer within 1 s",
    ),
    "closes all files and waits": (
        "os.closerange(0, 1000); time.sleep(1e6)",
        "step: its process answers no more: it has closed the connection",
    ),
    "reads the terminal": ("input()", "line 15, step: EOF when reading a line"),
    "raises much": ("raise ValueError(10**7 * 'x')", "step: x{500}[.]{3}"),
    "gives words": ("return ['5']", "step gives no numbers .*, but must give the force in N"),
    "gives infinity": ("return [float('-inf')]", "step gives a force that is not finite: .-inf. N"),
    "gives too many": ("return 10**6 * [1.0]", r"step gives a force of the shape \(1000000,\)"),
    "gives an odd tangent": ("self.stiffness = 'soft'", "stiffness is 'soft', but must be finite"),
    "writes to any file": (
        """
        for file in range(3, 4096):
            try:
                os.write(file, b"abcd" * 2)
            except OSError:
                pass
        """,
        "step: ",
    ),
}

STUCK = ("hangs", "closes all files and waits", "writes to any file")


@pytest.mark.parametrize("how", BREAKS)
def test_a_model_that_breaks_is_one_line_that_says_where(model, capfd, monkeypatch, how):
    code, why = BREAKS[how]
    if how.startswith(STUCK):  # the others have their time, on a busy machine too
        monkeypatch.setattr(model_process, "STEP_TIME", 1.0)
        ends = how == "hangs"  # it hears the signal, says where it is, and ends
        monkeypatch.setattr(model_process, "ENDING_TIME", 60.0 if ends else 0.1)
    source = model(code)
    _, error = run(source)
    assert re.search(why, error), error
    assert error.startswith(f"reference_force: computed.model: {source.name}")
    assert error.isprintable()
    assert len(error) < 1000
    out, err = capfd.readouterr()
    assert out == ""
    assert all(line.isprintable() for line in err.splitlines())
    assert nothing_left(source)


BEARABLE = {
    "prints": ("print('hello'); os.write(1, b'raw'); os.write(2, b'err')", "hello\nraw.?err"),
    "prints escapes": (r"print('\x1b]0;title\x07\x1b[2Jred\rover')", r"\\x1b]0;title\\x07"),
    "prints no text": (r"os.write(1, bytes(range(256)))", r"\\x00"),
    "takes signals": ("signal.signal(signal.SIGTERM, signal.SIG_IGN)", ""),
    "forks a child that stays": ("os.fork() or (os.setsid(), time.sleep(1e6))", ""),
    "starts threads": ("threading.Thread(target=time.sleep, args=[1e6]).start()", ""),
    "registers its end": ("import atexit; atexit.register(time.sleep, 1e6)", ""),
}


@pytest.mark.parametrize("how", BEARABLE)
def test_what_a_model_does_beside_its_work_stays_in_its_process(model, capfd, how):
    code, printed = BEARABLE[how]
    source = model(code)
    force, error = run(source)
    assert (force, error) == (10.0 * LAST, "")
    out, err = capfd.readouterr()
    assert out == ""
    assert all(line.isprintable() for line in err.splitlines())
    lines = "\n".join(line.removeprefix(f"{source.name}: ") for line in err.splitlines())
    assert re.search(printed, lines, re.DOTALL)
    assert nothing_left(source)


def test_what_a_model_prints_is_shown_up_to_a_limit(model, capfd):
    source = model("print(10**5 * 'many words ')\nfor k in range(10000): print(k)")
    assert run(source) == (10.0 * LAST, "")
    err = capfd.readouterr().err
    assert len(err) < 2 * model_process.LONGEST_OUTPUT
    assert err.count("it prints more") == 1


def test_a_model_that_hangs_in_its_end_is_ended(model, monkeypatch):
    monkeypatch.setattr(model_process, "ENDING_TIME", 0.1)
    source = model("def close(self):\n    time.sleep(1e6)", "MORE")
    assert run(source) == (10.0 * LAST, "")
    assert nothing_left(source)


def test_what_goes_wrong_in_the_end_of_a_model_is_shown(model, capfd):
    source = model("def close(self):\n    raise ValueError('not closed')", "MORE")
    assert run(source) == (10.0 * LAST, "")
    assert "line 19, close: not closed" in capfd.readouterr().err


def test_a_model_that_has_ended_starts_again_for_the_next_test(model):
    model_in_test = ComputedModel(model("if t > 1.0: os._exit(1)"))
    for _ in range(2):
        model_in_test.start(0.002)
        for step in range(4):
            model_in_test.step(0.002 * step, ZERO, ZERO, ZERO)
        with pytest.raises(ModelError, match="has ended with exit status 1"):
            model_in_test.step(2.0, ZERO, ZERO, ZERO)
    model_in_test.close()


def test_a_test_that_ends_while_a_model_computes_leaves_no_answer_to_the_next(model, capfd):
    model_in_test = ComputedModel(model("if t > 1.0: return time.sleep(0.02) or [77.0]"))
    model_in_test.start(0.002)
    for step in range(4):
        model_in_test.step(0.002 * step, ZERO, ZERO, ZERO)
    model_in_test.ask(2.0, ZERO, ZERO, ZERO)
    assert (model_in_test.start(0.002).force == 0.0).all()
    assert (model_in_test.step(0.0, ZERO, ZERO, ZERO).force == 0.0).all()
    model_in_test.ask(2.0, ZERO, ZERO, ZERO)
    model_in_test.close()
    assert capfd.readouterr().err == ""  # that nobody takes the answer is no fault of the model


def test_a_model_that_nobody_uses_ends(model):
    source = model("pass")
    ComputedModel(source).start(0.002)
    assert nothing_left(source)


HANGING = """
import sys
import numpy as np
from seft_plant_sim.computed.computed_model import ComputedModel, ModelSource

one, zero = np.eye(1), np.zeros(1)
model = ComputedModel(ModelSource(sys.argv[1], "", ("x",), one, 1, one))
model.start(0.002)
model.ask(0.0, zero, zero, zero)
print("asked", flush=True)
model.answer()
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_a_model_that_hangs_ends_with_the_process_that_uses_it(model, number):
    source = model("def commit(self):\n    time.sleep(1e6)", "MORE")
    words = [sys.executable, "-c", HANGING, source.name]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout.readline() == b"asked\n"
        process.send_signal(number)
    assert nothing_left(source)
