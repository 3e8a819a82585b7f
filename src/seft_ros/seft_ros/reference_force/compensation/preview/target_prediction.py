"""Coming target of the measured force, predicted with the whole structure."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from seft_plant_sim.first_order_hold import first_order_hold

from seft_ros.reference_force.compensation.compensator import Knowledge

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class NominalSpecimen:
    """Specimen that a force loop was identified with.

    Attributes
    ----------
    mass : ndarray
        M_0, shape (n, n), kg.
    restoring : ndarray
        (K_0, C_0), shape (n, 2n), N/m and N s/m.
    """

    mass: Floats
    restoring: Floats


WAY_BACK = 4.0  # Hz: a displacement that force errors caused goes back critically damped


class TargetPrediction:
    """Weighted sum of the coming target force, as gains of what is known now.

    Over the horizon the whole structure is at work: (M_e + M_c) x'' + C x' + K x + p =
    -(M_e + M_c) a_g, with the coming ground acceleration linear between samples, and p the part
    of the restoring force r that is not C x' + K x. The target is

        w = -M_e a_g + S r + N (x, v),  r = K x + C v + p

    With S = M_c (M_e + M_c)^-1 and N = 0 it is the reference force itself, the algebraic loop
    solved. Where the force loop feels the specimen, w is the force with which the specimen
    (M_0, C_0, K_0) that the loop was identified with would move as this one does: N = (K_0, C_0),
    S = -M_0 (M_e + M_c)^-1, and M_0 stands for M_e.

    Parameters
    ----------
    knowledge : Knowledge
        Masses and sampling period.
    weights : ndarray
        Sets of weights of the target from this step on, shape (m, 1 + horizon).
    nominal : NominalSpecimen or None
        None where the force loop does not feel the specimen.
    restoring : ndarray
        (K, C) of the specimen, shape (n, 2n).
    """

    def __init__(
        self,
        knowledge: Knowledge,
        weights: Floats,
        nominal: NominalSpecimen | None,
        restoring: Floats,
    ) -> None:
        n = knowledge.axes
        self._dt, self._weights = knowledge.dt, weights
        self._inverse_mass = np.linalg.inv(knowledge.total_mass)
        share: Floats = knowledge.computed_mass @ self._inverse_mass
        self._mass, self.nominal = knowledge.mass, np.zeros((n, 2 * n))
        self.other_mass: Floats = np.zeros((n, n))  # M_0 - M_e
        if nominal is not None:
            self.nominal, self._mass = nominal.restoring, nominal.mass
            self.other_mass = nominal.mass - knowledge.mass
            # S - 1 where the mass is the same
            share = share - np.eye(n) - self.other_mass @ self._inverse_mass
        self.share = share
        self.set_restoring(restoring)

    def set_restoring(self, restoring: Floats) -> None:
        """Take the specimen to be (K, C), shape (n, 2n)."""
        self._restoring = restoring
        self._slowing = self._inverse_mass @ restoring
        self._free, self._start, self._end = self._transition()

    def gains(self) -> tuple[Floats, Floats, Floats]:
        """Gains of (x, v), of the ground motion and of p.

        Returns
        -------
        motion : ndarray
            Shape (m n, 2n).
        ground_motion, rest : ndarray
            Of every step of the horizon, shape (m n, (1 + horizon) n).
        """
        sets, steps = self._weights.shape
        n = len(self._mass)
        ahead = _ahead(self._weights, self.share @ self._restoring + self.nominal, self._free)
        through = np.zeros((steps, sets * n, n))
        through[:-1] = ahead[1:] @ self._start
        through[1:] += ahead[1:] @ self._end
        direct = self._weights.T[:, :, np.newaxis, np.newaxis]
        ground = through - (direct * self._mass).reshape(steps, sets * n, n)
        rest = through @ self._inverse_mass + (direct * self.share).reshape(steps, sets * n, n)
        flat = (sets * n, steps * n)
        return (
            ahead[0].copy(),
            ground.transpose(1, 0, 2).reshape(flat),
            rest.transpose(1, 0, 2).reshape(flat),
        )

    def course(self) -> tuple[Floats, Floats, Floats]:
        """Motion that the whole structure makes of the ground motion, as one gives the next.

        Returns
        -------
        free, rest, ground_motion : ndarray
            Gains of (x, v), of p, and of the ground motion of this step and the next, shapes
            (2n, 2n), (2n, n) and (2n, 2n).
        """
        by_rest = (self._start + self._end) @ self._inverse_mass
        return self._free, by_rest, np.hstack([self._start, self._end])

    def way_back(self) -> Floats:
        """Gain of the target for a deviation (d, d') from that motion which is taken back.

        Over the horizon it goes back critically damped beside what the structure does of itself:
        (M_e + M_c) d'' + C d' + K d = -(M_e + M_c) (w^2 d + 2 w d').

        Returns
        -------
        ndarray
            Shape (n, 2n).
        """
        n = len(self._mass)
        w = 2 * np.pi * WAY_BACK
        back = np.hstack([w * w * np.eye(n), 2 * w * np.eye(n)])
        system = np.zeros((2 * n, 2 * n))
        system[:n, n:] = np.eye(n)
        system[n:] = -self._slowing - back
        target = self.share @ self._restoring + self.nominal - self._mass @ back
        gain: Floats = _ahead(self._weights[:1], target, expm(system * self._dt))[0]
        return gain

    def weighed(self, departures: Floats, targets: Floats) -> tuple[Floats, Floats, Floats]:
        """Gains of a weighted sum of the coming departures, and of the coming targets.

        As `gains` has them. The departure is K_0 x + C_0 v - r + (M_0 - M_e) x'', see `departing`.

        Parameters
        ----------
        departures, targets : ndarray
            Weights of each from this step on, shape (m, n, n), at most as long as the horizon.

        Returns
        -------
        motion, ground_motion, rest : ndarray
            Shapes (n, 2n) and (n, (1 + horizon) n), twice.
        """
        n, steps, count = len(self._mass), self._weights.shape[1], len(departures)
        departing, by_ground, by_rest = self.departing()
        target = self.share @ self._restoring + self.nominal
        by_motion = departures @ departing + targets @ target
        ground = np.zeros((steps, n, n))
        power = by_motion[-1]
        for step in range(count - 1, 0, -1):  # what enters in the step to `step`
            ground[step] += power @ self._end
            ground[step - 1] += power @ self._start
            power = power @ self._free + by_motion[step - 1]
        rest = ground @ self._inverse_mass
        rest[:count] += departures @ by_rest + targets @ self.share
        ground[:count] += departures @ by_ground - targets @ self._mass
        flat = (n, steps * n)
        return (
            power,
            ground.transpose(1, 0, 2).reshape(flat),
            rest.transpose(1, 0, 2).reshape(flat),
        )

    def departing(self) -> tuple[Floats, Floats, Floats]:
        """Gains of the force by which the specimen departs from that of the force loop now.

        Returns
        -------
        motion, ground_motion, rest : ndarray
            Of (x, v), a_g and p, shapes (n, 2n), (n, n) and (n, n).
        """
        by_rest = -np.eye(len(self._mass)) - self.other_mass @ self._inverse_mass
        return self.nominal + by_rest @ self._restoring, -self.other_mass, by_rest

    def displacements(self) -> tuple[Floats, Floats, Floats]:
        """Gains from which the coming displacements follow, as `gains` has them.

        Returns
        -------
        motion : ndarray
            Shape ((1 + horizon) n, 2n).
        ground_motion, rest : ndarray
            Shape ((1 + horizon) n, (1 + horizon) n).
        """
        n, steps = len(self._mass), self._weights.shape[1]
        powers = np.empty((steps, n, 2 * n))
        powers[0] = np.eye(n, 2 * n)
        for step in range(1, steps):
            powers[step] = powers[step - 1] @ self._free
        lag = np.subtract.outer(np.arange(steps), np.arange(steps))
        from_start = np.where(
            lag[..., np.newaxis, np.newaxis] > 0, (powers @ self._start)[lag - 1], 0.0
        )
        from_end = np.where(lag[..., np.newaxis, np.newaxis] >= 0, (powers @ self._end)[lag], 0.0)
        from_end[:, 0] = 0.0
        ground = from_start + from_end
        flat = (steps * n, steps * n)
        return (
            powers.reshape(steps * n, 2 * n),
            ground.transpose(0, 2, 1, 3).reshape(flat),
            (ground @ self._inverse_mass).transpose(0, 2, 1, 3).reshape(flat),
        )

    def _transition(self) -> tuple[Floats, Floats, Floats]:
        """Transition of (x, v) over a step: free, and by a_g at its start and at its end."""
        n = len(self._mass)
        system, push = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
        system[:n, n:] = np.eye(n)
        system[n:] = -self._slowing
        push[n:] = -np.eye(n)
        free, start, change = first_order_hold(system, push, self._dt)
        return free, start - change, change


def _ahead(weights: Floats, target: Floats, transition: Floats) -> Floats:
    """Weighted sums of ``target @ transition^k`` over the steps to come, from each step on.

    Shape (steps, m n, 2n) for m sets of weights.
    """
    sets, steps = weights.shape
    each = weights.T[:, :, np.newaxis, np.newaxis] * target
    ahead: Floats = each.reshape(steps, sets * len(target), -1)
    lag, power = 1, transition
    while lag < steps:  # each step is given the weights of twice as many coming ones
        ahead[:-lag] += ahead[lag:] @ power
        lag, power = 2 * lag, power @ power
    return ahead
