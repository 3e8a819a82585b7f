"""Filters of single channels, from a test by random commands.

Each channel may have passed a low-pass F = 1 / (1 + p s + q s^2). Up to the highest frequencies
that the commands excite, force, acceleration and displacement of a specimen are related by::

    F_i = sum_j (M_ij A_j + (K_ij + C_ij s + sum_k W_ijk s / (s + w_k)) X_j)               (1)

The relaxations w_k are what friction and yielding make of a random motion: stiff while it is small
or fast. Above the specimen's own frequencies the mass is nearly all of it. So the ratio of force
and acceleration shows a filter that one of them has and the other has not, most clearly where the
oil column rings, and where it matters. Below `OF_RATE` times the rate, where sampling folds nothing
down, velocity and acceleration show it against the displacement. Of a filter that all channels have
nothing is seen; it counts as dead time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from seft_msgs_py.arrays import Complexes, Floats
from seft_plant_sim.calibration import BUTTERWORTH, SIGNIFICANT
from seft_plant_sim.channels import ACCELERATION, DISPLACEMENT, FORCE
from seft_plant_sim.rig_parameters import filter_of

from seft_ros.identification.multisine import OF_RATE
from seft_ros.identification.multisine_estimates import Fit, regressed

HIGHEST = 0.4
"""Of the rate: the highest frequency that is used. A filter beyond what is used is but a lag."""
_RELAXATIONS = 6.0, 20.0, 60.0  # Hz
_STARTS, _ROUNDS, _STEP = 5, 15, 0.7  # natural frequencies to begin with; Gauss and Newton's steps
_SETTLED = 1e-3  # of its standard error: a step that changes nothing
_LAGS = np.arange(-10.0, 11.0) / 1e3  # s: starts
NUMERATOR, NONE, DENOMINATOR = -1, 0, 1
"""Sides of a relation y = x on which a filter stands: x has it not, nobody has, y has it."""


@dataclass(frozen=True)
class ChannelFilters:
    """Filters of the channels of n axes, shape (4, n) each.

    Attributes
    ----------
    filter, filter_error : ndarray
        Natural frequency, Hz, and its standard error; 0: none.
    filter_damping, filter_damping_error : ndarray
        Damping ratio.
    force_lag : ndarray
        Of the force behind the acceleration, beside these filters, shape (n,), s.
    """

    filter: Floats
    filter_error: Floats
    filter_damping: Floats
    filter_damping_error: Floats
    force_lag: Floats

    @classmethod
    def of(cls, known: Mapping[str, Floats]) -> "ChannelFilters":
        """Give those that are known, by the names of ``calibration.*``."""
        nothing = np.zeros_like(known["filter"])
        return cls(known["filter"], nothing, known["filter_damping"], nothing, nothing[0])

    @classmethod
    def none(cls, n: int) -> "ChannelFilters":
        """Give those of n axes without filters."""
        damping = np.full((4, n), BUTTERWORTH)
        nothing = np.zeros((3, 4, n))
        return cls(nothing[0], nothing[1], damping, nothing[2], np.zeros(n))

    def apart_from(self, known: "ChannelFilters", highest: float) -> "ChannelFilters":
        """Give the known ones where these are not significantly others, or can not be seen.

        ``highest`` is the highest frequency that was seen, Hz.
        """
        off = np.abs(self.filter - known.filter) > SIGNIFICANT * self.filter_error
        other = np.abs(self.filter_damping - known.filter_damping)
        off |= other > SIGNIFICANT * self.filter_damping_error
        off &= (self.filter > 0.0) | (known.filter < highest)
        parts = [*zip(vars(self).values(), vars(known).values(), strict=True)][:-1]
        hz, hz_error, damping, error = (np.where(off, one, other) for one, other in parts)
        return ChannelFilters(hz, hz_error, damping, error, self.force_lag)

    def response(self, w: Floats) -> Complexes:
        """Response of each channel at frequencies in rad/s, any shape, then (4, n)."""
        p, q = filter_of(self.filter, self.filter_damping)
        s = 1j * np.asarray(w)[..., np.newaxis, np.newaxis]
        return np.asarray(1.0 / (1.0 + p * s + q * s * s))

    def unsure(self, w: Floats) -> Floats:
        """Give what the standard errors mean for the response, relative and at most, (4, n)."""
        own, every = self.response(w), vars(self)
        others = (
            replace(self, **{name: every[name] + every[f"{name}_error"]}).response(w)
            for name in ("filter", "filter_damping")
        )
        off: Floats = np.linalg.norm([np.abs(one / own - 1.0) for one in others], axis=0)
        return off.max(axis=0)


@dataclass(frozen=True)
class _Found:
    """A filter on one side of a relation: logarithms of p and q, their errors, sum of squares.

    The lag of the left side, s, is beside it.
    """

    side: int
    lag: float
    value: Floats
    error: Floats
    left: float

    def numbers(self) -> tuple[float, float, float, float]:
        """Natural frequency in Hz, its error, damping ratio, its error."""
        (log_p, log_q), (of_p, of_q) = self.value, self.error
        hz, damping = np.exp(-log_q / 2.0) / (2 * np.pi), np.exp(log_p - log_q / 2.0) / 2.0
        return hz, hz * of_q / 2.0, damping, damping * np.hypot(of_p, of_q / 2.0)


def channel_filters(
    w: Floats,
    amplitude: Complexes,
    noise: Floats,
    dt: float,
    mass: tuple[Floats, Floats],
    derived: bool,
) -> ChannelFilters:
    """Find the filters of the channels.

    Parameters
    ----------
    w, amplitude, noise : ndarray
        Of lines of spectra: frequency, (m,), rad/s; displacement, velocity, acceleration and force,
        and the standard error of their real and imaginary parts, (m, 4, n).
    dt : float
        Sampling period, s.
    mass : tuple of ndarray
        Mass matrix and its standard errors, (n, n), kg.
    derived : bool
        Whether the velocity is derived from the displacement, and has no filter of its own.
    """
    found, n = ChannelFilters.none(amplitude.shape[2]), amplitude.shape[2]
    top = min(2 * np.pi * HIGHEST / dt, float(w.max()))
    for i in range(n):
        low = w < 2 * np.pi * OF_RATE / dt
        motion = [_of_motion(order, i, w[low], amplitude[low], noise[low], top) for order in (1, 2)]
        force = _of_force(i, w, amplitude, noise, top, mass)
        found.force_lag[i] = force.lag
        for row, one in enumerate(_by_channel(motion[1], None if derived else motion[0], force)):
            numbers = one.numbers() if one is not None else ()
            for part, number in zip(vars(found).values(), numbers, strict=False):
                part[row, i] = number
    return found


def _by_channel(
    acceleration: _Found | None, velocity: _Found | None, force: _Found
) -> list[_Found | None]:
    """Say which channel of an axis has which filter, from the relations that show one.

    Those of acceleration and velocity are against the displacement, of the force against the
    acceleration.
    """
    seen = [one if one and one.side else None for one in (acceleration, velocity)]
    x = next((one for one in seen if one and one.side == NUMERATOR), None)
    own = [one if one and one.side == DENOMINATOR else None for one in seen]
    a, v = (x if one is None else mine for one, mine in zip(seen, own, strict=True))
    if force.side != NUMERATOR:
        return [x, v, a, force if force.side else a]
    if seen[0] is None:  # all have it but the force
        return [force, v or force, force, None]
    return [x, v, force, None]


def _of_motion(
    order: int, i: int, w: Floats, amplitude: Complexes, noise: Floats, top: float
) -> _Found:
    """Filter of velocity or acceleration (order 1 or 2) against the displacement."""
    by_x = (1j * w) ** order
    motion = by_x[:, np.newaxis] * amplitude[:, DISPLACEMENT]
    error = noise[:, order, i], np.abs(by_x)[:, np.newaxis] * noise[:, DISPLACEMENT]
    nothing = np.zeros((len(w), 0), complex)
    return _likeliest(w, amplitude[:, order, i], error, motion, (nothing,) * 2, top)


def _of_force(
    i: int, w: Floats, amplitude: Complexes, noise: Floats, top: float, mass: tuple[Floats, Floats]
) -> _Found:
    """Filter of the force against the acceleration, see Eq. (1).

    The specimen's motion is that of both, by their noise, or of the one that has no filter.
    """
    used = w <= top
    w, amplitude, noise, s = w[used], amplitude[used], noise[used], 1j * w[used, np.newaxis]
    a, x = amplitude[:, ACCELERATION], amplitude[:, DISPLACEMENT]
    error = noise[:, FORCE, i], noise[:, ACCELERATION, [i]]

    def restoring(motion: Complexes) -> Complexes:
        slow = [motion * s / (s + 2 * np.pi * each) for each in _RELAXATIONS]
        return np.concatenate([a[:, others], motion, motion * s, *slow], axis=1)

    others = np.arange(a.shape[1]) != i  # their accelerometers have filters of their own
    value, deviation = (np.append(each[i, i], each[i, others]) for each in mass)
    prior = value, deviation
    squares = (s * s).real
    share = 1.0 / (1.0 + (squares * noise[:, DISPLACEMENT] / noise[:, ACCELERATION]) ** 2)
    ways = restoring(share * x + (1.0 - share) * a / squares), restoring(x)
    return _likeliest(w, amplitude[:, FORCE, i], error, a[:, [i]], ways, top, prior)


def _likeliest(
    w: Floats,
    y: Complexes,
    noises: tuple[Floats, Floats],
    columns: Complexes,
    ways: Sequence[Complexes],
    top: float,
    prior: tuple[Floats, Floats] | None = None,
) -> _Found:
    """Give the likeliest filter, of either side, that is significant, or none.

    y = columns b + others c; ``noises`` are those of y, (m,), and of the columns, (m, p). A filter
    of y is of all of it, one of the columns of them alone. ``ways`` are the others for these,
    ``top`` the highest frequency, rad/s. ``prior`` are values and errors of the first unknowns.
    """
    nothing = np.zeros(0)
    fits = (_fitted(w, y, noises, columns, others, NONE, nothing, prior) for others in ways)
    plain = min(fits, key=lambda one: one.left)
    best: _Found | None = None
    for side, others in zip((DENOMINATOR, NUMERATOR), ways, strict=True):
        for hz in np.geomspace(2 * np.pi * 15.0, top / (2.0 * HIGHEST), _STARTS):
            start = np.log([2.0 * BUTTERWORTH / hz, hz**-2.0])
            tried = _fitted(w, y, noises, columns, others, side, start, prior)
            is_seen = tried.numbers()[0] < top / (2 * np.pi)  # a faster one is but a lag
            if is_seen and (best is None or tried.left < best.left):
                best = tried
    if best is None:
        return plain
    spread = max(1.0, best.left / len(w) / 2.0)
    is_better = plain.left - best.left > 2.0 * SIGNIFICANT**2 * spread
    if not (is_better and (SIGNIFICANT * best.error < 1.0).all()):
        return plain
    others = ways[0 if best.side == DENOMINATOR else 1]  # with much noise it settles slowly
    return _fitted(w, y, noises, columns, others, best.side, best.value, prior)


def _fitted(
    w: Floats,
    y: Complexes,
    noises: tuple[Floats, Floats],
    columns: Complexes,
    others: Complexes,
    side: int,
    start: Floats,
    prior: tuple[Floats, Floats] | None,
) -> _Found:
    """Fit lag and filter by Gauss and Newton's method, from logarithms of p and q.

    With R = 1 + p s + q s^2 the noise sigma of what is left, r, is that of y and of
    R^-side columns b: what is taken back of a filter amplifies noise. So it changes with them::

        d (r / sigma) = (dr - r d(log sigma)) / sigma                                          (2)

    The squares of r / sigma are those of the likeliest motion, and the same on whichever side a
    filter is put: they say which channel has it.
    """
    s, found, m = 1j * w, np.append(0.0, start), columns.shape[1]
    noise = noises[0]

    def solved(unknown: Complexes, target: Complexes) -> Fit:
        if prior is None:
            return regressed(unknown, target, noise)
        rows = np.eye(len(prior[0]), unknown.shape[1], dtype=np.complex128)
        whole = np.concatenate([unknown, rows])
        return regressed(whole, np.append(target, prior[0]), np.append(noise, prior[1]))

    def terms(found: Floats) -> tuple[Complexes, Complexes, Complexes]:
        """Left side, unknowns, and R."""
        p, q = np.exp(found[1:]) if side else (0.0, 0.0)
        ratio = np.asarray(1.0 + p * s + q * s * s)
        passed = columns * (ratio**-side)[:, np.newaxis]
        beside = others / ratio[:, np.newaxis] if side == DENOMINATOR else others
        return y * np.exp(s * found[0]), np.concatenate([passed, beside], axis=1), ratio

    found[0] = _LAGS[_nearest(terms(found)[1], y, np.exp(np.outer(s, _LAGS)), noise)]
    for _ in range(_ROUNDS):
        turned, unknown, ratio = terms(found)
        value = solved(unknown, turned).value
        of_columns = (np.abs(ratio) ** -side)[:, np.newaxis] * noises[1] * value[:m]
        noise = np.sqrt(noises[0] ** 2 + (of_columns**2).sum(axis=1))
        share = of_columns**2 / noise[:, np.newaxis] ** 2  # d(log sigma) / d(log b)
        left, all_shares = turned - unknown @ value, share.sum(axis=1)
        used = len(value) if side == DENOMINATOR else m
        part, changes = unknown[:, :used] @ value[:used], [s * turned]
        if side:
            p, q = np.exp(found[1:])
            for change in (p * s / ratio, q * s * s / ratio):
                changes.append(side * (change * part + change.real * all_shares * left))
        unknown[:, :m] += left[:, np.newaxis] * share / value[:m]
        columns_now = np.concatenate([unknown, -np.stack(changes, axis=1)], axis=1)
        both = solved(columns_now, turned + all_shares * left)
        step, error = both.value[-len(found) :], both.error[-len(found) :]
        found = found + step * min(1.0, _STEP / max(np.abs(step[1:]).max(initial=0.0), 1e-9))
        if (np.abs(step) < _SETTLED * error).all():
            break
    turned, unknown, _ = terms(found)
    return _Found(side, float(found[0]), found[1:], error[1:], solved(unknown, turned).left)


def _nearest(unknown: Complexes, y: Complexes, turns: Complexes, noise: Floats) -> int:
    """Say which of some turned left sides, y turns[:, k], the unknowns explain best."""
    weighted, wanted = unknown / noise[:, np.newaxis], turns * (y / noise)[:, np.newaxis]
    a = np.concatenate([weighted.real, weighted.imag])
    basis, _ = np.linalg.qr(a / np.maximum(np.linalg.norm(a, axis=0), 1e-300))
    explained = basis.T @ np.concatenate([wanted.real, wanted.imag])
    return int((explained**2).sum(axis=0).argmax())
