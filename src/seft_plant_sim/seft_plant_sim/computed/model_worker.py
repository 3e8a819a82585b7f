"""The process of a computed model: it makes the user's class, and calls it on request.

The other side is `seft_plant_sim.computed.model_process`. All that a model can do wrong ends here:
an exception of any kind becomes one line of text, and a wrong value is refused.
"""

import contextlib
import ctypes
import faulthandler
import marshal
import os
import reprlib
import signal
import sys
from collections.abc import Mapping, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.registered import Registered, line_in, reason_of
from seft_msgs_py.errors import InputError

MODEL_PARAMETER = "reference_force: computed.model"
MODELS = Registered("seft.computed_model", ())
"""Models of other packages: name -> class, which may take settings."""
_METHODS = {"start": "dt, axes", "step": "t, displacement, velocity, ground_acceleration"}
PARTICIPLES = {"make": "made"}
"""Words for methods that are not the model's own."""
_PR_SET_PDEATHSIG = 1


class Model(Protocol):
    """The interface of a computed model; see docs/computed_models.md.

    In addition to ``start`` and ``step`` it may have

    - ``stiffness``, ``damping``: its present tangents, N/m and N s/m, shape (m, m) or one number;
      without them the tangents of a small motion from rest are used,
    - ``commit()``, called after each step,
    - ``responses()``, further values to record: name -> number; called after ``start`` and after
      each step,
    - ``close()``.

    Attributes
    ----------
    axes : int or sequence of str
        m, the number of the degrees of freedom that it acts on: those of the test's axes, then the
        internal ones; or their names: names of axes, ``internal 1`` and so on.
    """

    axes: int | Sequence[str]

    def start(self, dt: float, axes: Sequence[str]) -> None:
        """Begin a test from rest; forget earlier tests.

        ``dt`` is the time between two steps, s; ``axes`` are the m names.
        """

    def step(
        self, t: float, displacement: Floats, velocity: Floats, ground_acceleration: Floats
    ) -> Floats:
        """Go to the time t, s; give the force that holds the model there, shape (m,), N.

        The motion, m and m/s, is relative to the ground, whose acceleration is in m/s^2. The force
        of a spring is its stiffness times the displacement. Masses on the axes belong to
        ``computed.mass``.
        """


class ModelState(NamedTuple):
    """What a model answers after ``start`` and after a step.

    Attributes
    ----------
    force : ndarray
        That holds it in place, shape (m,), N; zero after ``start``.
    stiffness, damping : ndarray or None
        Its tangents, shape (m, m), N/m and N s/m; None if it does not give them.
    responses : dict
        Further values to record: name -> number.
    """

    force: Floats
    stiffness: Floats | None
    damping: Floats | None
    responses: dict[str, float]

    @classmethod
    def unpacked(cls, values: tuple[Any, ...]) -> "ModelState":
        """Read what a `ModelWorker` gives."""
        packed, *tangents, responses = values
        force = np.frombuffer(packed)
        stiffness, damping = (
            None if matrix is None else np.frombuffer(matrix).reshape(len(force), len(force))
            for matrix in tangents
        )
        return cls(force, stiffness, damping, responses)


class ModelWorker:
    """Makes one model and calls its methods, by requests of the same names."""

    def __init__(self, name: str, settings: str) -> None:
        self._name, self._settings = name, settings
        self._own: Any = None

    def make(self) -> tuple[int | list[str] | str, dict[str, int]]:
        """Make the model; give its axes, and the first lines of its methods.

        Axes that are neither a number nor a list of texts are given in words.
        """
        own = self._own = MODELS.make(self._name, self._settings, MODEL_PARAMETER)
        for name, takes in _METHODS.items():
            if not callable(getattr(own, name, None)):
                raise InputError(f"{MODEL_PARAMETER}: {self._name} has no {name}({takes})")
        axes = getattr(own, "axes", None)
        found: int | list[str] | str = reprlib.repr(axes)
        if isinstance(axes, int):
            found = int(axes)
        elif isinstance(axes, Sequence) and not isinstance(axes, str):
            named = list(axes)
            found = named if all(isinstance(axis, str) for axis in named) else found
        lines = ((name, self._first_line(name)) for name in _METHODS)
        return found, {name: line for name, line in lines if line}

    def start(self, dt: float, names: Sequence[str]) -> tuple[Any, ...]:
        """Begin a test; give the values of a `ModelState`, whose arrays marshal writes as bytes."""
        self._own.start(dt, names)
        return self._state(np.zeros(len(names)))

    def step(self, t: float, packed: bytes) -> tuple[Any, ...]:
        """Take a step to displacement, velocity and ground acceleration, shape (3, m)."""
        own, motion = self._own, np.frombuffer(packed).reshape(3, -1).copy()
        force = own.step(t, *motion)
        if hasattr(own, "commit"):
            own.commit()
        return self._state(self._checked(force, motion.shape[1]))

    def close(self) -> None:
        """End the model."""
        if hasattr(self._own, "close"):
            self._own.close()

    def failure(self, what: str, error: BaseException) -> str:
        """Describe a failure of a request in one line."""
        if isinstance(error, InputError):  # its text is complete
            return str(error)
        line = line_in(error, self._file())
        did = PARTICIPLES.get(what, what)
        return f"{MODEL_PARAMETER}: {self._name}{line}, {did}: {reason_of(error)}"

    def _state(self, force: Floats) -> tuple[Any, ...]:
        size = len(force)
        stiffness, damping = (self._tangent(name, size) for name in ("stiffness", "damping"))
        return force, stiffness, damping, self._responses()

    def _tangent(self, name: str, size: int) -> Floats | None:
        """Stiffness or damping that the model gives, shape (m, m); None if it gives none."""
        own = self._own
        is_given = hasattr(type(own), name) or name in getattr(own, "__dict__", {})
        if not is_given or (value := getattr(own, name)) is None:
            return None
        matrix = _numbers(value)
        if matrix is not None and matrix.shape in ((), (1,)):
            matrix = matrix * np.eye(size)
        if matrix is None or matrix.shape != (size, size) or not np.isfinite(matrix).all():
            need = f"but must be finite, of shape {size, size}"
            raise self._wrong(f"{name} is {reprlib.repr(value)}, {need}")
        return matrix

    def _responses(self) -> dict[str, float]:
        if not hasattr(self._own, "responses"):
            return {}
        found = self._own.responses()
        names = found if isinstance(found, Mapping) else [None]
        if not all(isinstance(name, str) and name.isprintable() for name in names):
            need = "but must give printable names and numbers"
            raise self._wrong(f"responses gives {reprlib.repr(found)}, {need}")
        return {str(name): float(value) for name, value in found.items()}

    def _checked(self, force: Any, size: int) -> Floats:
        """Check that the force is one finite number for each axis."""
        found = None if force is None else _numbers(force)
        if found is None:
            need = "but must give the force in N"
            raise self._wrong(f"step gives no numbers ({reprlib.repr(force)}), {need}")
        if found.shape != (size,):
            need = f"but must give {(size,)}: one value in N for each axis"
            raise self._wrong(f"step gives a force of the shape {found.shape}, {need}")
        if not np.isfinite(found).all():
            raise self._wrong(f"step gives a force that is not finite: {found.tolist()} N")
        return found

    def _wrong(self, what: str) -> InputError:
        """Make the error of a value that the model gives; it names the line of the method."""
        line = self._first_line(what.split()[0])
        where = f"{self._name} line {line}" if line else self._name
        return InputError(f"{MODEL_PARAMETER}: {where}: {what}")

    def _file(self) -> str | None:
        """File that defines the model."""
        file = self._name.rpartition(":")[0]
        module = sys.modules.get(file if self._own is None else type(self._own).__module__)
        return module.__file__ if module else str(Path(file).resolve())

    def _first_line(self, method: str) -> int:
        code = getattr(getattr(type(self._own), method, None), "__code__", None)
        return int(code.co_firstlineno) if code is not None else 0


def _numbers(value: Any) -> Floats | None:
    """Give real numbers as an array; None if the value holds anything else."""
    try:
        found = np.asarray(value)
        return None if found.dtype.kind in "cSUmM" else found.astype(np.float64, order="C")
    except (TypeError, ValueError):
        return None


def _serve(connection: Connection, worker: ModelWorker) -> None:
    """Answer requests until there are no more.

    A request is the name of a method of `ModelWorker` and its arguments; the answer is whether it
    was done, and its result or why not. marshal writes them in a tenth of the time of pickle.
    """
    process = os.getpid()
    with contextlib.suppress(EOFError, ConnectionError):  # the other side is done, or has ended
        while True:
            what, *arguments = marshal.loads(connection.recv_bytes())
            try:
                reply = True, getattr(worker, what)(*arguments)
            except BaseException as error:
                reply = False, worker.failure(what, error)
            if os.getpid() != process:  # the model has forked, and this is the other one
                os._exit(0)
            connection.send_bytes(marshal.dumps(reply))


def _die_with(parent: int) -> None:
    """Have this process ended with its parent, also where that has ended already."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:
        os._exit(1)


def main() -> None:
    """Serve the process that has started this one; its words are two descriptors, and a name."""
    forking = [os.getppid()]
    _die_with(forking[0])
    os.register_at_fork(
        before=lambda: forking.__setitem__(0, os.getpid()),
        after_in_child=lambda: _die_with(forking[0]),
    )
    connection = Connection(int(sys.argv[1]))
    # tells where the model crashes, or hangs when the other side ends it
    faulthandler.enable(int(sys.argv[2]), all_threads=False)
    sys.path[:], settings = marshal.loads(connection.recv_bytes())
    worker = ModelWorker(sys.argv[3], settings)
    try:
        _serve(connection, worker)
        worker.close()
    except BaseException as error:
        print(worker.failure("close", error), file=sys.stderr)
    finally:
        os._exit(0)  # neither threads of the model nor what it registered hold it up
