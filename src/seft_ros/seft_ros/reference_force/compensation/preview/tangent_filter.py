"""Tangent of a restoring force over displacement, followed on one axis."""

import math

_SUDDENNESS = 0.2  # of the stiffness: how much the tangent may change while r changes visibly
_VISIBLE = 5.0  # standard deviations of the measured restoring force
_STEEPEST, _SOFTEST = 0.05, -1.05  # bounds of the slope over the stiffness
_BEND_MEMORY = 0.7  # part of what is known of the slope's change that outlasts a step


class TangentFilter:
    """Kalman filter of p and its slope dp/dx over the displacement x, in plain floats.

    Where the velocity changes its sign the specimen unloads with its elastic stiffness: the
    slope of p, which is beside that, is zero again. Where it turns once more, and loads as it did
    before, the slope is what it was then, the less the further the force has gone since: small
    vibrations on the way do not hide that the specimen yields.

    Parameters
    ----------
    stiffness : float
        Elastic stiffness, N/m.
    noise : float
        Variance of the measured p, N^2.

    Attributes
    ----------
    slope, bend : float
        dp/dx in N/m, and how it changes on the way at present, in N/m^2.
    """

    def __init__(self, stiffness: float, noise: float) -> None:
        self._noise = noise
        self._visible = _VISIBLE * noise**0.5 / stiffness  # m
        self._largest = (_SUDDENNESS * stiffness) ** 2
        self._lowest, self._highest = _SOFTEST * stiffness, _STEEPEST * stiffness
        self.slope = self.bend = 0.0
        self._own, self._slopes, self._shared = noise, 0.0, 0.0  # variances of p and slope
        self._turning = self._way = 0.0
        self._last: tuple[float, float] | None = None
        self._stiffness = stiffness
        # of the last turn in each direction: the slope before it, and the restoring force
        self._turns = {1.0: (0.0, 0.0), -1.0: (0.0, 0.0)}

    def step(self, x: float, v: float, p: float, measured: float) -> float:
        """Follow p (N) to a new sample of displacement (m), velocity (m/s) and p; return it."""
        last_x, last_v = self._last or (x, v)
        self._last = (x, v)
        moved = x - last_x
        if v * last_v < 0.0:
            self.slope = self._turn(math.copysign(1.0, last_v), self._stiffness * last_x + p)
            self._shared = self._turning = self._way = 0.0
            self._slopes = self._largest
        before, shared = self.slope, self._shared
        own = self._own + moved * (2 * shared + moved * self._slopes) + 1e-3 * self._noise
        shared += moved * self._slopes
        slopes = self._slopes + self._largest * min(abs(moved) / self._visible, 1.0)
        error = measured - p - before * moved
        gain, slope_gain = own / (own + self._noise), shared / (own + self._noise)
        self.slope = min(max(before + slope_gain * error, self._lowest), self._highest)
        self._slopes = slopes - slope_gain * shared
        self._shared, self._own = shared * (1.0 - gain), own * (1.0 - gain)
        self._turning = _BEND_MEMORY * self._turning + (self.slope - before) * moved
        self._way = _BEND_MEMORY * self._way + moved * moved
        self.bend = self._turning / (self._way + self._visible * self._visible)
        return p + before * moved + gain * error

    def _turn(self, direction: float, force: float) -> float:
        """Leave a direction at a restoring force, N; give the slope in the other."""
        self._turns[direction] = self.slope, force
        slope, then = self._turns[-direction]
        return slope * max(0.0, 1.0 - abs(force - then) / abs(then)) if then else 0.0
