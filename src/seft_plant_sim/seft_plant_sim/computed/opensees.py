"""An OpenSeesPy script as a computed model.

The script makes nodes, materials and elements as usual, and names with `interface` the points at
which the test's axes act on it. The axes' displacements are imposed there, the ground motion acts
on the other masses, and the reactions are the model's force. See docs/computed_models.md.
"""

import itertools
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.registered import line_in, reason_of
from seft_msgs_py.errors import InputError

_WHERE = "reference_force: computed.model"
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
        Names of these degrees of freedom, see `seft_plant_sim.computed.model_worker.Model`;
        default: those of the test, in order.
    responses : mapping, optional
        Further responses to record: name -> function that gives a number.
    """
    if not _runs_script:
        return
    places = [[axis] if isinstance(axis[0], int) else list(axis) for axis in axes]
    raise _InterfaceReached(places, names, dict(responses or {}))


class OpenSees:
    """The computed model ``opensees``, see `seft_plant_sim.computed.model_worker.Model`.

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
        global _runs_script
        _runs_script = True
        if not Path(script).is_file():
            where = "reference_force: computed.settings"
            raise InputError(f"{where}: there is no script {script}; give its path")
        try:
            import openseespy.opensees as ops
        except Exception as error:
            raise InputError(
                f"{_WHERE}: {script}: OpenSeesPy can't be imported ({reason_of(error)}): "
                "pip install 'seft_plant_sim[opensees]'"
            ) from None
        self._ops, self._script, self._path = ops, script, Path(script).resolve()
        self._substeps, self._tolerance = substeps, tolerance
        sys.path.insert(0, str(self._path.parent))
        self.axes = self._build(1e-3)

    def start(self, dt: float, axes: Sequence[str]) -> None:
        """Build the model again."""
        del axes
        self._build(dt)

    @contextmanager
    def _script_errors(self) -> Iterator[None]:
        """Name the script, and its line, in an error."""
        try:
            yield
        except Exception as error:
            line = line_in(error, self._script)
            raise InputError(f"{_WHERE}: {self._script}{line}: {reason_of(error)}") from None

    def responses(self) -> dict[str, float]:
        """Give the script's responses to record."""
        with self._script_errors():
            return {name: float(get()) for name, get in self._responses.items()}

    def _build(self, dt: float) -> int | list[str]:
        """Build the model; give the number of its axes, or their names."""
        with self._script_errors():
            return self._built(dt)

    def _built(self, dt: float) -> int | list[str]:
        ops, self._dt = self._ops, dt
        ops.wipe()
        code = compile(self._path.read_text(encoding="utf-8"), self._script, "exec")
        try:
            exec(code, {"__name__": "__main__", "__file__": self._script})
        except _InterfaceReached as reached:
            self._axes, names, self._responses = reached.args
        else:
            what = "interface(...), which says where the axes act on the model"
            raise ValueError(f"the script has no line {what}")
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

    def step(
        self, t: float, displacement: Floats, velocity: Floats, ground_acceleration: Floats
    ) -> Floats:
        """Go to the time t; see `seft_plant_sim.computed.model_worker.Model`."""
        with self._script_errors():
            return self._step(t, np.array([displacement, velocity, ground_acceleration]))

    def _step(self, t: float, now: Floats) -> Floats:
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
