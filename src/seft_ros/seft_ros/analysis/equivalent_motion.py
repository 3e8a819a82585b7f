"""The ground motion of which a test, as it was measured, is the exact one."""

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.errors import InputError
from seft_plant_sim.reference.whole_structure import WholeStructure, whole_structure

Floats = npt.NDArray[np.float64]


def told_structure(experiment: Experiment, stiffness_factor: float = 1.0) -> Experiment | None:
    """Take of an experiment what the reference-force node was told of the structure.

    Parameters
    ----------
    experiment : Experiment
        Of a test.
    stiffness_factor : float
        Times the stiffness of the specimen's model.

    Returns
    -------
    Experiment or None
        One without a rig: its whole structure is linear, the model and the computed
        substructure. None if it does not describe one.
    """
    section = experiment.sections.get("reference_force", {})
    try:
        stiffness = np.multiply(section["model.stiffness"], stiffness_factor).tolist()
        told = Experiment({"reference_force": section | {"model.stiffness": stiffness}})
        whole_structure(told)
    except (InputError, KeyError):
        return None
    return told


class EquivalentMotion:
    """Follows the ground motion that a test was of, from what was measured.

    With the specimen's restoring force r = f - M_e a, and the force g of what is computed beside
    lumped mass (docs/theory.md, "More than lumped mass"), the whole structure obeys
    (M_e + M_c) (a + a_eq) + g = -r, so

        a_eq = -(M_e + M_c)^-1 (f + M_c a + g)

    Whatever the specimen is, the test is exact for a_eq. Internal degrees of freedom are driven by
    a_eq as well; they are integrated exactly where what was measured is linear between samples.
    In an EFT test the specimen carries all of the mass, and a_eq = -(M_e + M_c)^-1 f.

    Parameters
    ----------
    whole : WholeStructure
        Specimen and computed substructure; of the specimen the mass alone counts.
    dt : float
        Sampling period, s.

    Attributes
    ----------
    mass : ndarray
        M_e, that of the specimen, shape (n, n), kg.
    """

    def __init__(self, whole: WholeStructure, dt: float) -> None:
        computed = whole.computed.without_inertial_coupling()
        n = computed.axes
        on_axes = (slice(n), slice(n))
        self.mass = (whole.structure.mass[on_axes] - whole.computed.mass[on_axes]).copy()
        self._computed, self._dt = computed, dt
        self._inverse = np.linalg.inv(self.mass + computed.mass[on_axes])
        self._internal = np.zeros(2 * computed.internal)
        self._last: Floats | None = None  # input of the internal degrees of freedom

    def advance(self, states: Floats) -> Floats:
        """Go on over the next N steps; the first of all is step 0, at rest.

        Parameters
        ----------
        states : ndarray
            Displacement, velocity, acceleration and force as measured, shape (N, 4, n), N at
            least 1.

        Returns
        -------
        ndarray
            a_eq, shape (N, n), m/s^2.
        """
        x, v, a, f = np.moveaxis(states, 1, 0)
        n, computed = len(self.mass), self._computed
        m, c, k = (part[:n, :n] for part in (computed.mass, computed.damping, computed.stiffness))
        force = f + a @ m.T + v @ c.T + x @ k.T
        if computed.internal:
            force += self._pull(np.hstack([x, v, force]))
        return -force @ self._inverse.T

    def _pull(self, given: Floats) -> Floats:
        """Force of the internal degrees of freedom on the axes, from (x, v, the other force)."""
        from scipy.signal import lsim  # 20 MB that others need not have

        n, q, computed = len(self.mass), self._computed.internal, self._computed
        k, c = (
            np.linalg.solve(computed.mass[n:, n:], matrix[n:])
            for matrix in (computed.stiffness, computed.damping)
        )
        pull = np.hstack([computed.stiffness[:n, n:], computed.damping[:n, n:]])
        driven = computed.influence @ self._inverse
        a = np.vstack([np.eye(q, 2 * q, q), driven @ pull - np.hstack([k[:, n:], c[:, n:]])])
        b = np.vstack([np.zeros((q, 3 * n)), np.hstack([-k[:, :n], -c[:, :n], driven])])
        inputs = given if self._last is None else np.vstack([self._last, given])
        system = (a, b, pull, np.zeros((n, 3 * n)))
        if len(inputs) > 1:
            times = self._dt * np.arange(len(inputs))
            _, force, internal = lsim(system, inputs, times, self._internal)
            self._internal = np.atleast_2d(internal.reshape(len(inputs), -1))[-1]
            force = force.reshape(len(inputs), n)
        else:
            force = (pull @ self._internal)[np.newaxis]
        self._last = given[-1:].copy()
        return force[len(inputs) - len(given) :]
