"""One simulated test of the paper, and what came of it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from seft_msgs_py.config.experiment import Experiment
from seft_msgs_py.wire.topics import GROUND_MOTION, RIG_STATE

from seft_ros.analysis.metrics import Agreement, agreement
from seft_ros.analysis.summary import COMPARED, reference_of
from seft_ros.experiment.blocks import build_blocks
from seft_ros.experiment.offline import simulate
from seft_ros.paper.measures import Vibration, vibration, without_vibration
from seft_ros.recording.record import Trip

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Outcome:
    """Signals of a test up to its end or trip, and its exact response.

    Attributes
    ----------
    dt : float
        Sampling period, s.
    measured, exact : dict
        displacement (m), acceleration (m/s^2), force (N) -> shape (N,).
    trip : Trip or None
        Where a limit ended it.
    saturated : tuple of str
        What was at the end of its range, as the rig names it.
    input_peak : float
        Largest |m a_g|, N.
    """

    dt: float
    measured: dict[str, Floats]
    exact: dict[str, Floats]
    trip: Trip | None = None
    saturated: tuple[str, ...] = ()
    input_peak: float = 0.0

    @property
    def stable(self) -> bool:
        """Whether it ran to its end."""
        return self.trip is None and all(np.isfinite(y).all() for y in self.measured.values())

    @cached_property
    def time(self) -> Floats:
        """Shape (N,), s."""
        return self.dt * np.arange(len(self.measured["displacement"]), dtype=np.float64)

    def agreement(self, name: str) -> Agreement:
        """Hold a quantity against its exact response."""
        return agreement(self.measured[name], self.exact[name], self.dt)

    def controlled_agreement(self, name: str) -> Agreement:
        """Hold it against the exact response below the vibration, where force is controlled."""
        rate = 1.0 / self.dt
        measured = without_vibration(self.measured[name], rate)
        return agreement(measured, without_vibration(self.exact[name], rate), self.dt)

    def vibration(self, name: str) -> Vibration:
        """Vibration of a quantity as measured."""
        return vibration(self.measured[name], 1.0 / self.dt)

    def vibration_ratio(self, name: str) -> float:
        """Level of the vibration over that of the exact response; NaN where that has none."""
        exact = self.exact_vibration(name).rms
        return self.vibration(name).rms / exact if exact > 0 else float("nan")

    def exact_vibration(self, name: str) -> Vibration:
        """Vibration of the exact response: what it has at these frequencies."""
        return vibration(self.exact[name], 1.0 / self.dt)


def run_test(experiment: Experiment) -> Outcome:
    """Run a test offline, on the first axis."""
    record = simulate(experiment, build_blocks(experiment))
    reference = reference_of(record)
    assert reference is not None
    states = record.series[RIG_STATE.name].values
    mass = float(np.atleast_1d(experiment["reference_force"]["model.mass"])[0])
    motion = record.series[GROUND_MOTION.name].values
    return Outcome(
        experiment.timebase.dt,
        {name: states[:, row, 0] for name, row in COMPARED.items()},
        {name: getattr(reference, name)[:, 0] for name in COMPARED},
        record.trip,
        tuple(sorted(record.saturation.samples)),
        mass * float(np.abs(motion).max()),
    )


def against(test: Outcome, other: Outcome, name: str, *, controlled: bool = False) -> Agreement:
    """Hold a quantity of one test against another's, both of the same motion.

    A test that ended early agrees over what there is of it; ``controlled``: below the vibration.
    """
    y, reference = test.measured[name], other.measured[name]
    count = min(len(y), len(reference))
    y, reference = y[:count], reference[:count]
    if controlled:
        y, reference = (without_vibration(part, 1.0 / test.dt) for part in (y, reference))
    return agreement(y, reference, test.dt)
