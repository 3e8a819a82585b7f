"""Computed models of tests, as text of a file."""

MODELS = '''
import numpy as np


class Spring:
    """Hardening spring and damper on each axis."""

    def __init__(self, axes=1, k=1e5, k3=0.0, c=0.0):
        self.axes, self._k, self._k3, self._c = axes, k, k3, c

    def start(self, dt, axes):
        self.asked = []

    def step(self, t, displacement, velocity, ground_acceleration):
        spring = self._k * displacement + self._k3 * displacement**3
        return spring + self._c * velocity


class Bilinear:
    axes = 1

    def start(self, dt, axes):
        self.slip = 0.0

    def step(self, t, displacement, velocity, ground_acceleration):
        x = displacement[0]
        elastic = 9e4 * (x - self.slip)
        held = min(max(elastic, -270.0), 270.0)
        self.slip = x - held / 9e4
        return [held + 1e4 * x]


class Dashpot(Spring):
    def step(self, t, displacement, velocity, ground_acceleration):
        return 300.0 * velocity * abs(velocity)


class Maxwell(Spring):
    """A spring that a dashpot relaxes."""

    def step(self, t, displacement, velocity, ground_acceleration):
        self.asked.append(displacement)
        relaxed = sum(self.asked[:-1], 0.0 * displacement)
        return 1e4 * (displacement - 0.1 * relaxed)


class Stated(Spring):
    stiffness = 7.0

    @property
    def damping(self):
        return [[3.0]]


class Stepless:
    axes = 1

    def start(self, dt, axes):
        pass


class Unmade(Spring):
    def __init__(self):
        raise ValueError("no such thing")


class Damper:
    """A mass on a spring and a dashpot (implicit Euler would damp more: Newmark's method)."""

    axes = 1

    def start(self, dt, axes):
        self.dt, self.z, self.v, self.a = dt, 0.0, 0.0, 0.0

    def step(self, t, displacement, velocity, ground_acceleration):
        m, c, k, h = 8.0, 80.0, 11000.0, self.dt
        x, v = displacement[0], velocity[0]
        if t > 0.0:
            z, w = self.z + h * self.v + h * h / 4 * self.a, self.v + h / 2 * self.a
            pull = -m * ground_acceleration[0] - c * (w - v) - k * (z - x)
            self.a = pull / (m + h / 2 * c + h * h / 4 * k)
            self.z, self.v = z + h * h / 4 * self.a, w + h / 2 * self.a
        return [c * (v - self.v) + k * (x - self.z)]


class Breaking(Spring):
    def step(self, t, displacement, velocity, ground_acceleration):
        if t > 1.5:
            raise ValueError("it broke")
        return super().step(t, displacement, velocity, ground_acceleration)
'''
