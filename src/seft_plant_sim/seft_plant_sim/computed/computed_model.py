"""A part of the computed substructure that is a program: a user's class, stepped once a sample."""

import re
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from seft_msgs_py.arrays import Floats

from seft_plant_sim.computed.model_process import ModelError as ModelError
from seft_plant_sim.computed.model_process import ModelProcess
from seft_plant_sim.computed.model_worker import MODEL_PARAMETER, ModelState

SMALL_DISPLACEMENT, SMALL_VELOCITY = 1e-4, 1e-2
"""m and m/s, at which the tangent of a model is measured if the model does not give it."""
PROBE_PERIOD = 1e-3  # s
SAME_FORCE = 1e-9  # relative


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
    """

    places: tuple[int, ...]
    stiffness: Floats
    damping: Floats
    is_static: bool


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
    """A model in a test, in the coordinates of its source, in a process of its own.

    It must be started. If it can't be made, or one of its methods fails, the `ModelError` names the
    model's file and line.

    Attributes
    ----------
    places : tuple of int
        The degrees of freedom that it acts on.
    rows : ndarray
        Their displacements per coordinate, shape (m, N).
    """

    def __init__(self, source: ModelSource) -> None:
        self._source = source
        self._process = ModelProcess(source.name, source.settings)
        self._in_flight = False
        self.places = self._places(self._process.axes)
        self.rows = source.change[list(self.places)]
        self._names = tuple(source.dofs[place] for place in self.places)

    def _places(self, axes: int | list[str] | str) -> tuple[int, ...]:
        """Find the degrees of freedom that a model acts on."""
        name, dofs = self._source.name, self._source.dofs
        if isinstance(axes, int):
            if axes not in (len(self._source.influence.T), len(dofs)):
                other = f"the test has {len(self._source.influence.T)}: {', '.join(dofs)}"
                raise ModelError(f"{MODEL_PARAMETER}: {name} has {axes} axes, but {other}")
            return tuple(range(axes))
        named = axes if isinstance(axes, list) else []
        if not named or any(axis not in dofs or named.count(axis) > 1 for axis in named):
            need = f"must be their number, or different ones of {', '.join(dofs)}"
            raise ModelError(f"{MODEL_PARAMETER}: axes of {name} are {axes}, but {need}")
        return tuple(map(dofs.index, named))

    def start(self, dt: float) -> ModelState:
        """Begin a test, with steps of ``dt`` s."""
        if self._in_flight:  # a test has ended while the model computed
            self.close()
        if not self._process.is_open:
            self._process = ModelProcess(self._source.name, self._source.settings)
        self._in_flight = False
        return self._taken(self._request("start", dt, self._names))

    def step(self, t: float, displacement: Floats, velocity: Floats, ground: Floats) -> ModelState:
        """Go to the time t; give the force in the coordinates, shape (N,).

        ``displacement`` and ``velocity`` are those of the coordinates, ``ground`` is the ground
        acceleration of the degrees of freedom; shape (N,) each. The tangents have shape (N, N).
        """
        self.ask(t, displacement, velocity, ground)
        return self.answer()

    def ask(self, t: float, displacement: Floats, velocity: Floats, ground: Floats) -> None:
        """Begin a step; the model computes while the loop continues."""
        self._in_flight = True
        own = self.rows @ displacement, self.rows @ velocity, ground[list(self.places)]
        self._process.begin("step", t, np.array(own))

    def answer(self) -> ModelState:
        """Wait for the end of the step; the result is that of `step`."""
        found = ModelState.unpacked(self._process.result())
        self._in_flight = False
        return self._taken(found)

    def close(self) -> None:
        """End the model."""
        self._process.close()

    def probe(self) -> Probed:
        """Measure small motions from rest; the model must be started again."""
        size = len(self.places)
        rest = np.zeros(size)

        def forces(displacement: Floats, velocity: Floats) -> Floats:
            """Give the force at rest, and then in two steps at a motion, shape (3, m)."""
            self._request("start", PROBE_PERIOD, self._names)
            motions = ((rest, rest), (displacement, velocity), (displacement, velocity))
            steps = [
                self._request("step", k * PROBE_PERIOD, np.array([x, v, rest]))
                for k, (x, v) in enumerate(motions)
            ]
            return np.array([step.force for step in steps])

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
        begun = self._request("start", PROBE_PERIOD, self._names)
        for matrix, own in zip(columns, (begun.stiffness, begun.damping), strict=True):
            matrix[:] = 0.5 * (matrix + matrix.T) if own is None else own
        return Probed(self.places, columns[0], columns[1], is_static)

    def _request(self, what: str, *arguments: Any) -> ModelState:
        return ModelState.unpacked(self._process.request(what, *arguments))

    def _taken(self, found: ModelState) -> ModelState:
        """Give an answer of the model in the coordinates."""
        rows = self.rows
        stiffness, damping = (
            None if tangent is None else rows.T @ tangent @ rows
            for tangent in (found.stiffness, found.damping)
        )
        return ModelState(rows.T @ found.force, stiffness, damping, found.responses)


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
