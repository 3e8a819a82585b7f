"""The load-resisting member under test."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from seft_msgs_py.config.arrays import Floats, mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import RigAxes

from seft_plant_sim.specimen.restoring_force import Spring
from seft_plant_sim.specimen.spring_kinds import make_springs


@dataclass(frozen=True)
class Specimen:
    """Mass, damping and restoring force of a specimen: M a + C v + r(x) = f (Eq. 2.4).

    Linear, r = K x. With springs that are not linear, r = D^T s, where their deformations are
    e = D x; as long as they are elastic this is K x again (friction acts beside it).

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        M, C and K, shape (n, n), in kg, N s/m and N/m.
    springs : tuple of Spring
        p of them; none: the specimen is linear.
    deformation : ndarray
        D, shape (p, n): deformation of each spring per displacement of each axis.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    springs: tuple[Spring, ...] = ()
    deformation: Floats = field(default_factory=lambda: np.zeros((0, 0)))

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: Sequence[str], where: str
    ) -> "Specimen":
        """Make it of parameters ``mass``, ``damping``, ``stiffness``, and ``kind`` if given.

        Raises
        ------
        InputError
            If a matrix does not fit the axes, is not symmetric, mass is not positive, or the
            stiffness is not what such springs add up to.
        """
        linear = cls(
            mass=mass_matrix(section["mass"], axes, f"{where}.mass"),
            damping=symmetric_matrix(section["damping"], axes, f"{where}.damping"),
            stiffness=symmetric_matrix(section["stiffness"], axes, f"{where}.stiffness"),
        )
        kind = section.get("kind", "linear")
        if kind == "linear":
            return linear
        deformation = deformations(section["springs"], axes, where)
        stiffness = _spring_stiffness(linear.stiffness, deformation, where)
        springs = make_springs(kind, section, stiffness, where)
        return replace(linear, springs=springs, deformation=deformation)

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass)

    def part(self, rig: RigAxes, where: str) -> "Specimen":
        """Take the part that one of several rigs has.

        Raises
        ------
        InputError
            If a matrix or a spring couples axes of different rigs.
        """
        own = list(rig.places)
        others = [place for place in range(self.axes) if place not in own]
        for name in ("mass", "damping", "stiffness"):
            if getattr(self, name)[np.ix_(own, others)].any():
                raise InputError(
                    f"{where}.{name} couples axes of {rig.name} with those of another rig; what "
                    "rigs share can only be computed: give it as reference_force: computed.*"
                )
        touching = self.deformation[:, own].any(axis=1) if self.springs else np.zeros(0, bool)
        if self.springs and self.deformation[np.ix_(touching, others)].any():
            raise InputError(f"{where}.springs: a spring connects {rig.name} with another rig")
        square = np.ix_(own, own)
        return Specimen(
            self.mass[square],
            self.damping[square],
            self.stiffness[square],
            tuple(itertools.compress(self.springs, touching)),
            self.deformation[touching][:, own] if self.springs else self.deformation,
        )

    def state_matrices(self) -> tuple[Floats, Floats]:
        """State-space form over (x, v), driven by the force f, of the elastic specimen.

        Returns
        -------
        a, b : ndarray
            Shapes (2n, 2n) and (2n, n): d/dt (x, v) = a (x, v) + b f.
        """
        n = self.axes
        a = np.zeros((2 * n, 2 * n))
        a[:n, n:] = np.eye(n)
        a[n:, :n] = -np.linalg.solve(self.mass, self.stiffness)
        a[n:, n:] = -np.linalg.solve(self.mass, self.damping)
        b = np.zeros((2 * n, n))
        b[n:] = np.linalg.inv(self.mass)
        return a, b


def deformations(value: float | Sequence[float], axes: Sequence[str], where: str) -> Floats:
    """Matrix D over n axes, shape (p, n): deformation of each spring per displacement.

    A single 0 stands for one spring between each axis and the ground.

    Raises
    ------
    InputError
        If there are not n values for each spring; ``where`` names the parameters' group.
    """
    numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    n = len(axes)
    if numbers.size == 1 and numbers[0] == 0.0:
        return np.eye(n)
    if numbers.size % n:
        raise InputError(
            f"{where}.springs: {numbers.size} values for {n} axes {list(axes)}; give {n} for "
            "each spring (its deformation per displacement of each axis), spring by spring"
        )
    return numbers.reshape(-1, n)


def _spring_stiffness(stiffness: Floats, deformation: Floats, where: str) -> list[float]:
    """Stiffnesses k of springs with deformations D that add up to K = D^T diag(k) D."""
    each = np.array([np.outer(row, row).ravel() for row in deformation]).T
    found = np.linalg.lstsq(each, stiffness.ravel(), rcond=None)[0]
    if not np.allclose(each @ found, stiffness.ravel(), rtol=0.0, atol=1e-6 * stiffness.max()):
        raise InputError(
            f"{where}.stiffness {stiffness.tolist()} is not what springs with the deformations "
            f"{deformation.tolist()} add up to; name the springs in {where}.springs"
        )
    if found.min() <= 0.0:
        raise InputError(
            f"{where}.stiffness: the springs' own come out as {np.round(found, 6).tolist()} N/m, "
            f"but must be positive; mend {where}.springs or the stiffness"
        )
    return found.tolist()
