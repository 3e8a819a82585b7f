"""A part of the computed substructure that is a program: a user's class, stepped once a sample."""

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.registered import Registered, line_in, reason_of
from seft_msgs_py.errors import InputError

WHERE = "reference_force: computed.model"
MODELS = Registered("seft.computed_model", ())
"""Models of other packages: name -> class, which may take settings."""
SMALL_DISPLACEMENT, SMALL_VELOCITY = 1e-4, 1e-2
"""m and m/s, at which the tangent of a model is measured if the model does not give it."""
PROBE_PERIOD = 1e-3  # s
SAME_FORCE = 1e-9  # relative


class Model(Protocol):
    """The interface of a computed model; see docs/computed_models.md.

    In addition to ``start`` and ``step`` it may have

    - ``stiffness``, ``damping``: its present tangents, N/m and N s/m, shape (m, m) or one number;
      without them the tangents of a small motion from rest are used,
    - ``commit()``, called after each step,
    - ``responses()``, further values to record: name -> number,
    - ``ask(t, displacement, velocity, ground_acceleration)`` and ``answer()``, which replace
      ``step`` if the model computes in another process (`computed.every` above 1),
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


class ModelError(InputError):
    """A computed model can't be used, or has failed."""


class Probed(NamedTuple):
    """Properties of a model of m degrees of freedom, measured by small motions from rest.

    Attributes
    ----------
    places : tuple of int
        The degrees of freedom.
    stiffness, damping : ndarray
        Shape (m, m), N/m and N s/m.
    is_static : bool
        Whether its force depends on the path alone, except for linear dampers.
    is_apart : bool
        Whether it computes while the loop continues, by ``ask`` and ``answer``.
    """

    places: tuple[int, ...]
    stiffness: Floats
    damping: Floats
    is_static: bool
    is_apart: bool


@dataclass(frozen=True)
class ModelSource:
    """Makes a model from its parameters.

    Attributes
    ----------
    name, settings : str
        ``computed.model`` and ``computed.settings``.
    dofs : tuple of str
        Names of all N degrees of freedom: the axes, then the internal ones.
    influence : ndarray
        Ground acceleration of each per that of each axis, shape (N, n).
    every : int
        Samples from one of its steps to the next.
    change : ndarray
        Their displacements per coordinate of the substructure, shape (N, N).
    """

    name: str
    settings: str
    dofs: tuple[str, ...]
    influence: Floats
    every: int
    change: Floats

    @cached_property
    def tangents(self) -> tuple[Floats, Floats]:
        """Stiffness and damping at rest in these coordinates, each of shape (N, N)."""
        rows = self.change[list(self.probed.places)]
        return rows.T @ self.probed.stiffness @ rows, rows.T @ self.probed.damping @ rows

    @cached_property
    def probed(self) -> Probed:
        """Properties of the model over its own axes."""
        words = (self.name.rpartition(":")[0], *re.split(r"[\s=]+", self.settings))
        files = [Path(word) for word in words if word]
        versions = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
        return _probe(self.name, self.settings, self.dofs, self.influence.shape[1], versions)


class ComputedModel:
    """A model in a test, in the coordinates of its source; all its results are checked.

    It must be started. If it can't be made, or one of its methods fails, the `ModelError` names the
    model's file and line.

    Attributes
    ----------
    places : tuple of int
        The degrees of freedom that it acts on.
    rows : ndarray
        Their displacements per coordinate, shape (m, N).
    is_apart : bool
        Whether it has ``ask`` and ``answer``.
    """

    def __init__(self, source: ModelSource) -> None:
        self._source = source
        self._own: Any = None
        own = self._own = self._call("made", MODELS.make, source.name, source.settings, WHERE)
        self.is_apart = hasattr(own, "ask") and hasattr(own, "answer")
        for name, takes in (
            ("start", "dt, axes"),
            ("step", "t, displacement, velocity, ground_acceleration"),
        ):
            if not callable(getattr(own, name, None)):
                raise ModelError(f"{WHERE}: {source.name} has no {name}({takes})")
        self.places = self._places(getattr(own, "axes", None))
        self.rows = source.change[list(self.places)]
        self._names = tuple(source.dofs[place] for place in self.places)

    def _places(self, axes: Any) -> tuple[int, ...]:
        """Find the degrees of freedom that a model acts on."""
        name, dofs = self._source.name, self._source.dofs
        if isinstance(axes, int):
            if axes not in (len(self._source.influence.T), len(dofs)):
                raise ModelError(
                    f"{WHERE}: {name} has {axes} axes, but the test has "
                    f"{len(self._source.influence.T)}: {', '.join(dofs)}"
                )
            return tuple(range(axes))
        named = list(axes) if isinstance(axes, Sequence) and not isinstance(axes, str) else []
        if not named or any(axis not in dofs or named.count(axis) > 1 for axis in named):
            raise ModelError(
                f"{WHERE}: axes of {name} are {axes!r}, but must be their number, or different "
                f"ones of {', '.join(dofs)}"
            )
        return tuple(map(dofs.index, named))

    def start(self, dt: float) -> None:
        """Begin a test, with steps of ``dt`` s."""
        self._call("start", self._own.start, dt, self._names)

    def step(self, t: float, displacement: Floats, velocity: Floats, ground: Floats) -> Floats:
        """Go to the time t; give the force in the coordinates, shape (N,).

        ``displacement`` and ``velocity`` are those of the coordinates, ``ground`` is the ground
        acceleration of the degrees of freedom; shape (N,) each.
        """
        return self._taken("step", self._tell("step", t, displacement, velocity, ground))

    def ask(self, t: float, displacement: Floats, velocity: Floats, ground: Floats) -> None:
        """Begin a step of a model that `is_apart`."""
        self._tell("ask", t, displacement, velocity, ground)

    def answer(self) -> Floats:
        """Wait for the end of the step; the result is that of `step`."""
        return self._taken("answer", self._call("answer", self._own.answer))

    def tangents(self) -> tuple[Floats | None, Floats | None]:
        """Give the present stiffness and damping, shape (N, N); None if the model has none."""
        own = [self._own_tangent(name) for name in ("stiffness", "damping")]
        stiffness, damping = (
            None if found is None else self.rows.T @ found @ self.rows for found in own
        )
        return stiffness, damping

    def responses(self) -> dict[str, float]:
        """Give the model's further values to record."""
        if not hasattr(self._own, "responses"):
            return {}
        found = self._call("responses", self._own.responses)
        return {str(name): float(value) for name, value in found.items()}

    def close(self) -> None:
        """End the model's other processes."""
        if hasattr(self._own, "close"):
            self._own.close()

    def probe(self) -> Probed:
        """Measure small motions from rest; the model must be started again."""
        size = len(self.places)
        rest = np.zeros(size)

        def forces(displacement: Floats, velocity: Floats) -> Floats:
            """Give the force at rest, and then in two steps at a motion, shape (3, m)."""
            self.start(PROBE_PERIOD)
            motions = ((rest, rest), (displacement, velocity), (displacement, velocity))
            steps = [
                self._call(
                    "step", self._own.step, k * PROBE_PERIOD, x.copy(), v.copy(), rest.copy()
                )
                for k, (x, v) in enumerate(motions)
            ]
            return np.array([self._checked("step", force) for force in steps])

        still = forces(rest, rest)
        columns = np.zeros((2, size, size))
        is_static = _equal(still, still[:1])
        for j, unit in enumerate(np.eye(size)):
            moved = forces(SMALL_DISPLACEMENT * unit, rest)
            fast = forces(rest, SMALL_VELOCITY * unit)
            columns[0, :, j] = (moved[1] - still[1]) / SMALL_DISPLACEMENT
            columns[1, :, j] = (fast[1] - still[1]) / SMALL_VELOCITY
            faster = forces(rest, 2.0 * SMALL_VELOCITY * unit) - still
            is_static &= _equal(moved[2], moved[1]) and _equal(fast[2], fast[1])
            is_static &= _equal(faster, 2.0 * (fast - still))
        self.start(PROBE_PERIOD)
        for matrix, name in zip(columns, ("stiffness", "damping"), strict=True):
            own = self._own_tangent(name)
            matrix[:] = 0.5 * (matrix + matrix.T) if own is None else own
        return Probed(self.places, columns[0], columns[1], is_static, self.is_apart)

    def _tell(self, what: str, t: float, x: Floats, v: Floats, ground: Floats) -> Any:
        own = self.rows @ x, self.rows @ v, ground[list(self.places)]
        return self._call(what, getattr(self._own, what), t, *own)

    def _taken(self, what: str, force: Any) -> Floats:
        if hasattr(self._own, "commit"):
            self._call("commit", self._own.commit)
        return self.rows.T @ self._checked(what, force)

    def _checked(self, what: str, force: Any) -> Floats:
        size = len(self.places)
        try:
            found = np.array(force, dtype=np.float64)
        except (TypeError, ValueError):
            raise self._error(what, "gives no numbers, but must give the force in N") from None
        if found.shape != (size,):
            raise self._error(
                what,
                f"gives a force of the shape {found.shape}, but must give {(size,)}: one value in "
                "N for each axis",
            )
        if not np.isfinite(found).all():
            raise self._error(what, f"gives a force that is not finite: {found.tolist()} N")
        return found

    def _own_tangent(self, name: str) -> Floats | None:
        """Stiffness or damping that the model gives, shape (m, m); None if it gives none."""
        if not hasattr(type(self._own), name) and name not in getattr(self._own, "__dict__", {}):
            return None
        size, value = len(self.places), self._call(name, getattr, self._own, name)
        if value is None:
            return None
        matrix = np.asarray(value, dtype=np.float64)
        if matrix.shape in ((), (1,)):
            matrix = matrix * np.eye(size)
        if matrix.shape != (size, size) or not np.isfinite(matrix).all():
            raise self._error(
                name, f"is {np.asarray(value).tolist()}, but must be finite, of shape {size, size}"
            )
        return matrix

    def _call(self, what: str, function: Callable[..., Any], *arguments: Any) -> Any:
        try:
            return function(*arguments)
        except InputError as error:  # its text is complete
            raise ModelError(str(error)) from error
        except Exception as error:
            name = self._source.name
            file = name.rpartition(":")[0]
            module = sys.modules.get(file if self._own is None else type(self._own).__module__)
            line = line_in(error, module.__file__ if module else str(Path(file).resolve()))
            raise ModelError(f"{WHERE}: {name}{line}, {what}: {reason_of(error)}") from error

    def _error(self, what: str, text: str) -> ModelError:
        method = getattr(type(self._own), what, None)
        code = getattr(method, "__code__", None)
        line = f" line {code.co_firstlineno}" if code is not None else ""
        return ModelError(f"{WHERE}: {self._source.name}{line}: {what} {text}")


def _equal(one: Floats, other: Floats) -> bool:
    """Say whether forces are equal, except for rounding."""
    return bool(np.abs(one - other).max() <= SAME_FORCE * max(np.abs(other).max(), 1e-300))


@lru_cache(maxsize=64)
def _probe(
    name: str, settings: str, dofs: tuple[str, ...], axes: int, versions: tuple[int, ...]
) -> Probed:
    """Probe a new model; again only if its files have changed."""
    del versions
    unit = np.eye(len(dofs))
    model = ComputedModel(ModelSource(name, settings, dofs, unit[:, :axes], 1, unit))
    try:
        return model.probe()
    finally:
        model.close()
