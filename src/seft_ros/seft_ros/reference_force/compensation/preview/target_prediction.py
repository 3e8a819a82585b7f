"""Coming target of the measured force, predicted with the whole structure."""

from dataclasses import dataclass
from typing import NamedTuple

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


class Gains(NamedTuple):
    """How something that is to come follows from what is known now.

    Attributes
    ----------
    motion : ndarray
        Of (x, v), shape (m, 2n).
    ground_motion, rest : ndarray
        Of a_g and p in every step of the horizon, shape (m, (1 + horizon) n).
    committed : ndarray
        Of the forces f + d that are on their way, shape (m, (1 + committed) n).
    """

    motion: Floats
    ground_motion: Floats
    rest: Floats
    committed: Floats


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

    Such a loop moves any specimen as the forces f + d move (M_0, C_0, K_0), d being what the
    specimen departs by, and what it was asked for lately is on its way and can't be changed any
    more. So over the first ``committed`` steps M_0 x'' + C_0 x' + K_0 x is f + d, and the whole
    structure is at work from there on. Were it at work at once, a motion that nobody meant would
    be answered, a delay later, as if the loop had answered it before: of a specimen softer than
    K_0, fast modes would grow.

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
    committed : int
        Steps, fewer than the horizon; 0 where it is not known what is on its way.
    """

    def __init__(
        self,
        knowledge: Knowledge,
        weights: Floats,
        nominal: NominalSpecimen | None,
        restoring: Floats,
        committed: int = 0,
    ) -> None:
        n = knowledge.axes
        self.committed = committed
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
            inverse = np.linalg.inv(nominal.mass)
            self._moved = _transition(inverse @ nominal.restoring, inverse, knowledge.dt)
        self.share = share
        self.set_restoring(restoring)

    def set_restoring(self, restoring: Floats) -> None:
        """Take the specimen to be (K, C), shape (n, 2n)."""
        self._restoring = restoring
        self._slowing = self._inverse_mass @ restoring
        self._whole = _transition(self._slowing, -np.eye(len(self._mass)), self._dt)
        self._by_motion = self.share @ restoring + self.nominal  # the target's part
        # of the targets to come, from each step on in which nothing is committed any more
        self._ahead = _ahead(self._weighted(self._by_motion)[self.committed :], self._whole[0])

    def gains(self) -> Gains:
        """Gains of the targets, of all sets of weights one below the other."""
        each, begin, ahead = self._weighted(self._by_motion), self.committed, self._ahead
        _, start, end = self._whole
        through = np.zeros((len(each), each.shape[1], len(self._mass)))
        through[begin:-1] = ahead[1:] @ start
        through[1 + begin :] += ahead[1:] @ end
        motion, _, committed = self._from_here(ahead[0], each[:begin])
        return self._gains(
            motion,
            through - self._weighted(self._mass),
            through @ self._inverse_mass + self._weighted(self.share),
            committed,
        )

    def course(self) -> tuple[Floats, Floats, Floats]:
        """Motion that the whole structure makes of the ground motion, as one gives the next.

        Returns
        -------
        free, rest, ground_motion : ndarray
            Gains of (x, v), of p, and of the ground motion of this step and the next, shapes
            (2n, 2n), (2n, n) and (2n, 2n).
        """
        free, start, end = self._whole
        return free, (start + end) @ self._inverse_mass, np.hstack([start, end])

    def way_back(self) -> Floats:
        """Lowering of the first set's target for a deviation (d, d') from that motion.

        From where nothing is committed any more the deviation goes back critically damped beside
        what the structure does of itself: (M_e + M_c) d'' + C d' + K d =
        -(M_e + M_c) (w^2 d + 2 w d').

        Returns
        -------
        ndarray
            Shape (n, 2n), of (d, d') in that step.
        """
        n = len(self._mass)
        back = critically_damped(WAY_BACK, n)
        system = np.zeros((2 * n, 2 * n))
        system[:n, n:] = np.eye(n)
        system[n:] = -self._slowing - back
        first = self._weights[0, self.committed :, np.newaxis, np.newaxis]
        each = first * (self._by_motion - self._mass @ back)
        lowering: Floats = self._ahead[0, :n] - _ahead(each, expm(system * self._dt))[0]
        return lowering

    def mending(self) -> tuple[Gains, Floats]:
        """Gains of the lowering that takes a deviation from a course back, see `way_back`.

        The course is the motion that `course` gives, told as another (x, v).

        Returns
        -------
        gains : Gains
            As `gains` has them, of n forces.
        course : ndarray
            Gains of the course, shape (n, 2n).
        """
        lowering = self.way_back()
        before = np.zeros((self.committed, *lowering.shape))
        motion, _, committed = self._from_here(lowering, before)
        course, entering, _ = self._from_here(lowering, before, whole=True)
        return self._gains(motion, -entering, -entering @ self._inverse_mass, committed), -course

    def weighed(self, departures: Floats, targets: Floats) -> Gains:
        """Gains of a weighted sum of the coming departures, and of the coming targets.

        The departure is K_0 x + C_0 v - r + (M_0 - M_e) x'', see `departing`.

        Parameters
        ----------
        departures, targets : ndarray
            Weights of each from this step on, shape (m, n, n), at most as long as the horizon.
        """
        departing, by_ground, by_rest = self.departing()
        by_motion = departures @ departing + targets @ self._by_motion
        motion, ground, committed = self._from_here(by_motion[-1], by_motion[:-1])
        rest = ground @ self._inverse_mass
        rest[: len(departures)] += departures @ by_rest + targets @ self.share
        ground[: len(departures)] += departures @ by_ground - targets @ self._mass
        return self._gains(motion, ground, rest, committed)

    def departing(self) -> tuple[Floats, Floats, Floats]:
        """Gains of the force by which the specimen departs from that of the force loop now.

        Returns
        -------
        motion, ground_motion, rest : ndarray
            Of (x, v), a_g and p, shapes (n, 2n), (n, n) and (n, n).
        """
        by_rest = -np.eye(len(self._mass)) - self.other_mass @ self._inverse_mass
        return self.nominal + by_rest @ self._restoring, -self.other_mass, by_rest

    def displacements(self) -> Gains:
        """Gains of the coming displacements, (1 + horizon) times n of them."""
        n, steps = len(self._mass), self._weights.shape[1]
        of_motion, of_steps, of_committed = 2 * n, steps * n, (1 + self.committed) * n
        places = of_motion, of_motion + of_steps, of_motion + of_steps + of_committed
        motion = np.eye(2 * n, places[2])  # by what is known now, step by step
        found = [motion[:n]]
        for step in range(1, steps):
            is_committed = step <= self.committed
            free, start, end = self._moved if is_committed else self._whole
            at = places[1 if is_committed else 0] + (step - 1) * n
            motion = free @ motion
            motion[:, at : at + n] += start
            motion[:, at + n : at + 2 * n] += end
            found.append(motion[:n])
        by_motion, ground, committed = np.split(np.concatenate(found), places[:2], axis=1)
        rest = ground.reshape(-1, n) @ self._inverse_mass
        return Gains(by_motion, ground, rest.reshape(ground.shape), committed)

    def _weighted(self, part: Floats) -> Floats:
        """Each step's weights times a part of its target, shape (1 + horizon, m n, ...)."""
        each = self._weights.T[:, :, np.newaxis, np.newaxis] * part
        return each.reshape(len(each), -1, part.shape[1])

    def _from_here(
        self, last: Floats, before: Floats, whole: bool = False
    ) -> tuple[Floats, Floats, Floats]:
        """Gains of a sum over (x, v) of coming steps: those ``before``, and of one after them.

        With ``whole`` the whole structure is at work all the time. Shapes (m, 2n), (1 + horizon,
        m, n) and (1 + committed, m, n), of (x, v) now, of ground motion and of committed forces.
        """
        n, steps, begin = len(self._mass), self._weights.shape[1], self.committed
        ground = np.zeros((steps, len(last), n))
        committed = np.zeros((1 + begin, len(last), n))
        gain = last
        for step in range(len(before), 0, -1):  # what enters on the way to `step`
            is_whole = whole or step > begin
            free, start, end = self._whole if is_whole else self._moved
            entering = ground if is_whole else committed
            entering[step] += gain @ end
            entering[step - 1] += gain @ start
            gain = gain @ free + before[step - 1]
        return gain.copy(), ground, committed

    @staticmethod
    def _gains(motion: Floats, *of_steps: Floats) -> Gains:
        """Put the gains of several steps side by side."""
        flat = [part.transpose(1, 0, 2).reshape(len(motion), -1) for part in of_steps]
        return Gains(motion, *flat)


def critically_damped(hz: float, axes: int) -> Floats:
    """Acceleration (w^2, 2 w) over (d, d') that takes d back at a frequency, shape (n, 2n)."""
    w = 2 * np.pi * hz
    return np.hstack([w * w * np.eye(axes), 2 * w * np.eye(axes)])


def _transition(slowing: Floats, push: Floats, dt: float) -> tuple[Floats, Floats, Floats]:
    """Transition of (x, v) over a step: free, and by what pushes at its start and at its end."""
    n = len(push)
    system, entering = np.zeros((2 * n, 2 * n)), np.zeros((2 * n, n))
    system[:n, n:] = np.eye(n)
    system[n:], entering[n:] = -slowing, push
    free, start, change = first_order_hold(system, entering, dt)
    return free, start - change, change


def _ahead(each: Floats, transition: Floats) -> Floats:
    """Sum ``each[k + j] @ transition^j`` over the steps to come, from each step k on."""
    ahead, lag, power = each.copy(), 1, transition
    while lag < len(ahead):  # each step is given those of twice as many coming ones
        ahead[:-lag] += ahead[lag:] @ power
        lag, power = 2 * lag, power @ power
    return ahead
