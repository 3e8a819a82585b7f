"""An OpenSeesPy script as a computed model, in a process of its own: OpenSees's state is global.

The script makes nodes, materials and elements as usual, and names with `interface` the points at
which the test's axes act on it. The axes' displacements are imposed there, the ground motion acts
on the other masses, and the reactions are the model's force. See docs/computed_models.md.
"""

import itertools
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from multiprocessing.connection import Connection, Pipe
from pathlib import Path
from typing import Any, NoReturn

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.registered import line_in, reason_of
from seft_msgs_py.errors import InputError

START_TIME = 60.0  # s, for the worker to import OpenSees and run the script
STEP_TIME = 5.0  # s, after which a step hangs
ENDING_TIME = 2.0  # s
_MANY = 900_000  # first tag of nodes and elements that are added to the script's model
Place = tuple[int, int]
_runs_script = False


class _InterfaceReached(BaseException):
    """Ends a script at its line `interface`."""


def interface(
    *axes: Place | Sequence[Place],
    names: Sequence[str] | None = None,
    responses: Mapping[str, Callable[[], float]] | None = None,
) -> None:
    """Name the points of a script's model at which the axes of the test act on it.

    In a test the script ends here, and the lines below are not run: the test supplies earthquake
    and analysis. Outside a test this function does nothing.

    Parameters
    ----------
    *axes : (int, int) or sequence of (int, int)
        Node and direction of each axis, or several that move together. A support there is released.
        The node must have no mass there: it belongs to ``reference_force: computed.mass``.
    names : sequence of str, optional
        Names of these degrees of freedom, see `seft_plant_sim.computed_model.Model`; default:
        those of the test, in order.
    responses : mapping, optional
        Further responses to record: name -> function that gives a number.
    """
    if not _runs_script:
        return
    places = [[axis] if isinstance(axis[0], int) else list(axis) for axis in axes]
    raise _InterfaceReached(places, names, dict(responses or {}))


class OpenSees:
    """The computed model ``opensees``, see `seft_plant_sim.computed_model.Model`.

    Parameters
    ----------
    script : str
        Path of the script.
    substeps : int
        Steps of the analysis from one sample to the next.
    tolerance : float
        Largest norm of the last displacement increment, m.
    """

    def __init__(self, script: str, substeps: int = 1, tolerance: float = 1e-9) -> None:
        if not Path(script).is_file():
            raise InputError(
                f"reference_force: computed.settings: there is no script {script}; give its path"
            )
        self._script, self._substeps = script, substeps
        own, other = Pipe()
        self._own: Connection = own
        self._errors = tempfile.TemporaryFile()  # noqa: SIM115  # as long as the worker
        words = (
            "from seft_plant_sim.opensees import serve; "
            f"serve({other.fileno()}, {script!r}, {int(substeps)}, {float(tolerance)!r})"
        )
        self._worker = subprocess.Popen(
            [sys.executable, "-c", words],
            stdin=subprocess.DEVNULL,
            stdout=self._errors,
            stderr=self._errors,
            pass_fds=(other.fileno(),),
            start_new_session=True,  # Ctrl-C is for those who ramp the test down
            env={**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
        )
        other.close()
        self.axes: int | list[str] = self._ask(START_TIME, "start", 1e-3)

    def start(self, dt: float, axes: Sequence[str]) -> None:
        """Build the model again."""
        del axes
        self._ask(START_TIME, "start", dt)

    def step(
        self, t: float, displacement: Floats, velocity: Floats, ground_acceleration: Floats
    ) -> Floats:
        """Go to the time t; see `seft_plant_sim.computed_model.Model`."""
        self.ask(t, displacement, velocity, ground_acceleration)
        return self.answer()

    def ask(
        self, t: float, displacement: Floats, velocity: Floats, ground_acceleration: Floats
    ) -> None:
        """Begin a step."""
        self._send("step", t, np.array([displacement, velocity, ground_acceleration]))

    def answer(self) -> Floats:
        """Wait for its end; give the reactions, N."""
        reactions: Floats = self._receive(STEP_TIME)
        return reactions

    def responses(self) -> dict[str, float]:
        """Give the script's responses to record."""
        found: dict[str, float] = self._ask(STEP_TIME, "responses")
        return found

    def close(self) -> None:
        """End the worker."""
        self._own.close()
        try:
            self._worker.wait(ENDING_TIME)
        except subprocess.TimeoutExpired:  # it hangs in a step
            self._worker.kill()
            self._worker.wait()
        self._errors.close()

    def __del__(self) -> None:
        """End the worker of the last test."""
        if hasattr(self, "_worker") and not self._own.closed:
            self.close()

    def _ask(self, patience: float, *request: Any) -> Any:
        self._send(*request)
        return self._receive(patience)

    def _send(self, *request: Any) -> None:
        """Send the name of one of the methods of `_Worker`, and its arguments."""
        try:
            self._own.send(request)
        except OSError:
            self._fail(": the process of OpenSees has ended")

    def _receive(self, patience: float) -> Any:
        try:
            if not self._own.poll(patience):
                self._fail(f": OpenSees did not answer within {patience:g} s")
            is_done, reply = self._own.recv()
        except EOFError:
            self._fail(": the process of OpenSees has ended")
        if not is_done:
            self._fail(reply)
        return reply

    def _fail(self, why: str) -> NoReturn:
        """Raise an error with the last output of OpenSees."""
        self._errors.seek(0)
        lines = self._errors.read().decode(errors="replace").splitlines()
        last = [line.strip() for line in lines if line.strip()][-1:]
        said = f" (OpenSees: {last[0]})" if last else ""
        raise InputError(f"reference_force: computed.model: {self._script}{why}{said}")


def serve(descriptor: int, script: str, substeps: int, tolerance: float) -> None:
    """Serve an `OpenSees` until it ends; this runs in the worker."""
    global _runs_script
    _runs_script = True
    connection = Connection(descriptor)
    try:
        import openseespy.opensees as ops
    except Exception as error:
        why = f": OpenSeesPy can't be imported ({reason_of(error)})"
        connection.send((False, f"{why}: pip install 'seft_plant_sim[opensees]'"))
        return
    worker = _Worker(ops, script, substeps, tolerance)
    while True:
        try:
            method, *arguments = connection.recv()
        except (EOFError, OSError):
            os._exit(0)  # OpenSees prints when it ends in order
        try:
            reply = True, getattr(worker, method)(*arguments)
        except Exception as error:
            sys.stderr.flush()
            reply = False, f"{line_in(error, script)}: {reason_of(error)}"
        connection.send(reply)


class _Worker:
    """Runs the script and the analysis."""

    def __init__(self, ops: Any, script: str, substeps: int, tolerance: float) -> None:
        self._ops, self._script = ops, script
        self._substeps, self._tolerance = substeps, tolerance
        sys.path.insert(0, str(Path(script).parent))

    def responses(self) -> dict[str, float]:
        """Give the script's responses to record."""
        return {name: float(get()) for name, get in self._responses.items()}

    def start(self, dt: float) -> int | list[str]:
        """Build the model; give the number of its axes, or their names."""
        ops, self._dt = self._ops, dt
        ops.wipe()
        code = compile(Path(self._script).read_text(encoding="utf-8"), self._script, "exec")
        try:
            exec(code, {"__name__": "__main__", "__file__": self._script})
        except _InterfaceReached as reached:
            self._axes, names, self._responses = reached.args
        else:
            raise ValueError(
                "the script has no line interface(...), which says where the axes act on the model"
            )
        for node, direction in itertools.chain.from_iterable(self._axes):
            if mass := ops.nodeMass(node, direction):
                raise ValueError(
                    f"node {node} has a mass of {mass:g} kg in direction {direction}, at the "
                    "interface: remove it, and add it to reference_force: computed.mass"
                )
            if direction in ops.getFixedDOFs(node):
                ops.remove("sp", node, direction)
        if not any(map(self._free, ops.getNodeTags())):  # nothing to solve for: add a free node
            size = len(ops.nodeDisp(self._axes[0][0][0]))
            ops.node(_MANY, *[0.0] * len(ops.nodeCoord(self._axes[0][0][0])))
            ops.mass(_MANY, *[1.0] * size)
        ops.loadConst("-time", 0.0)
        ops.wipeAnalysis()
        ops.constraints("Transformation")
        ops.numberer("RCM")
        ops.system("BandGeneral")
        ops.test("NormDispIncr", self._tolerance, 25)
        ops.algorithm("Newton")
        ops.integrator("Newmark", 0.5, 0.25)
        ops.analysis("Transient")
        ops.timeSeries("Constant", _MANY)
        self._directions = sorted({axis[0][1] for axis in self._axes})
        self._shaken = False
        self._origin = [[ops.nodeDisp(*place) for place in axis] for axis in self._axes]
        self._last = np.zeros((3, len(self._axes)))
        self._standing = np.zeros(len(self._axes))
        self._standing = self._reactions()
        return list(names) if names else len(self._axes)

    def _free(self, node: int) -> set[int]:
        """Give the directions in which the analysis moves a node."""
        held = {direction for axis in self._axes for at, direction in axis if at == node}
        directions = range(1, len(self._ops.nodeDisp(node)) + 1)
        return set(directions) - held - set(self._ops.getFixedDOFs(node))

    def step(self, t: float, now: Floats) -> Floats:
        """Go to the time t and its displacements, velocities and ground accelerations, (3, m)."""
        if t > 0.0:
            for step in range(1, self._substeps + 1):
                part = step / self._substeps
                self._impose(*(self._last + part * (now - self._last)).tolist())
                self._analyse(t)
        self._last = now
        return self._reactions()

    def _impose(self, x: list[float], v: list[float], ground: list[float]) -> None:
        """Make the loads of the end of a step."""
        ops = self._ops
        if self._shaken:
            ops.remove("loadPattern", _MANY)
            for direction in self._directions:
                ops.remove("loadPattern", _MANY + direction)
                ops.remove("timeSeries", _MANY + direction)
        self._shaken = True
        for direction in self._directions:
            axes = zip(self._axes, ground, strict=True)
            found = {shaken for axis, shaken in axes if axis[0][1] == direction}
            if len(found) > 1:
                raise ValueError(
                    f"axes in direction {direction} have different ground motions; the ground of "
                    "a script moves as one"
                )
            ops.timeSeries("Constant", _MANY + direction, "-factor", found.pop())
            series = "-accel", _MANY + direction
            ops.pattern("UniformExcitation", _MANY + direction, direction, *series)
        ops.pattern("Plain", _MANY, _MANY)
        for i, (axis, origins) in enumerate(zip(self._axes, self._origin, strict=True)):
            for place, origin in zip(axis, origins, strict=True):
                ops.setNodeVel(*place, v[i], "-commit")
                ops.sp(*place, origin + x[i])

    def _analyse(self, t: float) -> None:
        """Take a step; if Newton's method does not converge, try other methods."""
        ops, dt = self._ops, self._dt / self._substeps
        if ops.analyze(1, dt) == 0:
            return
        for algorithm in (("KrylovNewton",), ("NewtonLineSearch",), ("ModifiedNewton", "-initial")):
            ops.algorithm(*algorithm)
            found = ops.analyze(1, dt)
            ops.algorithm("Newton")
            if found == 0:
                return
        raise ValueError(
            f"the analysis does not converge at {t:g} s: give more substeps, or a larger "
            "tolerance, for example computed.settings: substeps=4"
        )

    def _reactions(self) -> Floats:
        """Find the forces that hold the interface: of elements and damping, without inertia."""
        ops, total = self._ops, -self._standing
        for kind in ((), ("-rayleigh",)):
            ops.reactions(*kind)
            total = total + [sum(ops.nodeReaction(*at) for at in axis) for axis in self._axes]
        return total
