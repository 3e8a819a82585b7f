"""The computed substructure: masses, dampers and springs in addition to the specimen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from seft_msgs_py.arrays import Floats
from seft_msgs_py.config.parameter_table import mass_matrix, symmetric_matrix
from seft_msgs_py.errors import InputError

from seft_plant_sim.computed.computed_model import ModelSource

_NAMES = ("mass", "damping", "stiffness", "internal", "influence")


@dataclass(frozen=True)
class ComputedSubstructure:
    """Linear structure over the n axes, its interface, and q internal degrees of freedom.

    With x of the axes, z of the internal degrees of freedom, and the force -g on the specimen::

        M (x'' + a_g, z'' + L a_g) + C (x', z') + K (x, z) = (-g, 0)

    The lumped mass of the paper has M alone, without internal degrees of freedom. A computed
    model adds its force; C and K contain the model's tangents at rest.

    Attributes
    ----------
    mass, damping, stiffness : ndarray
        M, C and K, shape (n + q, n + q), in kg, N s/m and N/m; the axes come first.
    influence : ndarray
        L, shape (q, n): ground acceleration of each internal degree of freedom per that of each
        axis.
    on_axes : ndarray or None
        The same of each axis, shape (n, n); None: each axis has its own ground acceleration. It is
        zero for an axis that measures a deformation above another degree of freedom.
    model : ModelSource or None
        Computed model: its force minus that of its tangents acts in addition to the matrices.
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    influence: Floats
    on_axes: Floats | None = None
    model: ModelSource | None = None

    @classmethod
    def from_parameters(
        cls, section: dict[str, Any], axes: Sequence[str]
    ) -> "ComputedSubstructure":
        """Make it from a section of reference_force: ``computed.*`` times ``mass_ratio``.

        The mass ratio does not change the model. Without ``computed.mass`` the mass is that of
        the specimen.

        Raises
        ------
        InputError
            If a matrix does not fit, is not symmetric, an internal mass is not positive, or the
            model can't be used.
        """
        where, n = "reference_force: computed", len(axes)
        given = {name: section[f"computed.{name}"] for name in _NAMES}
        ratio, q = section["mass_ratio"], int(given["internal"])
        names = (*axes, *(f"internal {index + 1}" for index in range(q)))
        if np.any(given["mass"]):
            mass = symmetric_matrix(given["mass"], names, f"{where}.mass")
        elif q:
            raise InputError(
                f"{where}.internal is {q}, but {where}.mass is not given: give the masses of the "
                "axes and of the internal degrees of freedom"
            )
        else:
            mass = mass_matrix(section["specimen.mass"], axes, "/**: specimen.mass")
        if q and np.linalg.eigvalsh(mass[n:, n:])[0] <= 0.0:
            other = "the mass of the internal degrees of freedom must be positive (definite)"
            raise InputError(f"{where}.mass is {given['mass']}, but {other}")
        damping, stiffness = (
            symmetric_matrix(given[name], names, f"{where}.{name}")
            for name in ("damping", "stiffness")
        )
        on_axes, influence = _influence(given["influence"], n, q, f"{where}.influence")
        whole = cls(ratio * mass, ratio * damping, ratio * stiffness, influence, on_axes)
        name = section["computed.model"]
        if not name:
            return whole
        settings, every = section["computed.settings"], section["computed.every"]
        model = ModelSource(name, settings, names, whole.by_axis, every, np.eye(n + q))
        k, c = model.tangents
        return replace(whole, stiffness=whole.stiffness + k, damping=whole.damping + c, model=model)

    @classmethod
    def lumped(cls, mass: Floats) -> "ComputedSubstructure":
        """Make one with masses on the axes only, shape (n, n), kg."""
        nothing = np.zeros_like(mass)
        return cls(mass, nothing, nothing, nothing[:0])

    @property
    def internal(self) -> int:
        """Number of internal degrees of freedom q."""
        return len(self.influence)

    @property
    def axes(self) -> int:
        """Number of axes n."""
        return len(self.mass) - self.internal

    @property
    def by_axis(self) -> Floats:
        """Ground acceleration of all degrees of freedom per that of each axis, (n + q, n)."""
        on_axes = np.eye(self.axes) if self.on_axes is None else self.on_axes
        return np.vstack([on_axes, self.influence])

    @property
    def is_lumped(self) -> bool:
        """Whether it has masses on the axes only."""
        linear = self.internal or self.damping.any() or self.stiffness.any()
        return not (linear or self.model is not None)

    def without_inertial_coupling(self) -> "ComputedSubstructure":
        """Measure internal displacements from the masses' positions under a slow interface motion.

        With z = y - M_zz^-1 M_zx x no mass couples axes and y; the force g is the same.
        """
        n, q = self.axes, self.internal
        if not q or not self.mass[n:, :n].any():
            return self
        shift = -np.linalg.solve(self.mass[n:, n:], self.mass[n:, :n])
        change = np.eye(n + q)
        change[n:, :n] = shift
        mass, damping, stiffness = (
            change.T @ matrix @ change for matrix in (self.mass, self.damping, self.stiffness)
        )
        mass[:n, n:] = mass[n:, :n] = 0.0
        model = self.model and replace(self.model, change=self.model.change @ change)
        influence = self.influence - (shift if self.on_axes is None else shift @ self.on_axes)
        return ComputedSubstructure(mass, damping, stiffness, influence, self.on_axes, model)


def _influence(
    value: float | Sequence[float], axes: int, internal: int, where: str
) -> tuple[Floats | None, Floats]:
    """Ground acceleration of the axes, if given, and of the internal degrees of freedom."""
    numbers = np.atleast_1d(np.asarray(value, dtype=np.float64))
    if not numbers.any():
        return None, np.eye(1, axes).repeat(internal, axis=0)
    if internal and numbers.size == (axes + internal) * axes:
        on_axes, inside = np.split(numbers.reshape(-1, axes), [axes])
        return on_axes, inside
    if numbers.size != internal * axes:
        raise InputError(
            f"{where}: {numbers.size} values for {internal} internal degrees of freedom and "
            f"{axes} axes; give {internal * axes}, those of each internal degree of freedom "
            f"together, or {(axes + internal) * axes}, those of the axes first"
        )
    return None, numbers.reshape(internal, axes)
