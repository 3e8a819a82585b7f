"""What a compensation method identifies on line <-> bytes of a DiagnosticArray."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from seft_msgs_py.errors import WireError
from seft_msgs_py.wire.messages import OK, Status, decode_diagnostics, encode_diagnostics
from seft_msgs_py.wire.timebase import Timebase
from seft_msgs_py.wire.topics import ESTIMATES

Floats = npt.NDArray[np.float64]

_PREFIX = f"{ESTIMATES.publisher}: "


class EstimatesCodec:
    """Estimates of one step <-> message bytes.

    A diagnostic_msgs/msg/DiagnosticArray with the stamp of the step, and for each axis a status
    ``reference_force: <axis>`` whose values are the estimates by name. Numbers are written as
    Python's `repr` does, so that they are read back bit for bit.

    Parameters
    ----------
    axes : sequence of str
        Names of the n axes, in order.
    timebase : Timebase
        Sampling clock that gives steps their stamps.
    """

    def __init__(self, axes: Sequence[str], timebase: Timebase) -> None:
        self._names = [_PREFIX + axis for axis in axes]
        self._timebase = timebase

    def encode(self, step: int, estimates: Mapping[str, Floats]) -> bytes:
        """Make the message of one step.

        Parameters
        ----------
        step : int
            Step that the estimates belong to.
        estimates : mapping of str to ndarray
            Name -> estimate of each axis, shape (n,), SI units.

        Raises
        ------
        WireError
            If there are none, a shape does not fit the axes, or a value is not finite.
        """
        if not estimates:
            raise WireError(f"{ESTIMATES.name}: a message needs at least one estimate")
        values: list[dict[str, str]] = [{} for _ in self._names]
        for name, estimate in estimates.items():
            if np.shape(estimate) != (len(values),):
                raise WireError(
                    f"{ESTIMATES.name}: {name} has shape {np.shape(estimate)}, "
                    f"not ({len(values)},) (axes)"
                )
            for status, text, value in zip(self._names, values, estimate, strict=True):
                text[name] = repr(_finite(float(value), name, status))
        statuses = [
            Status(status, OK, "identified on line", values=text)
            for status, text in zip(self._names, values, strict=True)
        ]
        return encode_diagnostics(self._timebase.stamp_ns(step), statuses)

    def decode(self, raw: bytes) -> tuple[int, dict[str, Floats]]:
        """Read a message.

        Returns
        -------
        step : int
            Step that the estimates belong to.
        estimates : dict of str to ndarray
            Name -> estimate of each axis, shape (n,), all finite; at least one.

        Raises
        ------
        WireError
            If the bytes are no such message, or not of these axes and steps.
        """
        stamp_ns, statuses = decode_diagnostics(raw)
        found = [status.name for status in statuses]
        if found != self._names:
            raise WireError(f"{ESTIMATES.name}: statuses are {found}, not {self._names}")
        names = list(statuses[0].values)
        if not names or any(list(status.values) != names for status in statuses):
            raise WireError(f"{ESTIMATES.name}: axes need the same estimates, at least one")
        rows = {name: [_number(s.values[name], name, s.name) for s in statuses] for name in names}
        return self._timebase.step(stamp_ns), {name: np.array(row) for name, row in rows.items()}


def _number(text: str, name: str, status: str) -> float:
    try:
        return _finite(float(text), name, status)
    except ValueError:
        raise WireError(f"{ESTIMATES.name}: {name} of {status} is {text!r}, no number") from None


def _finite(value: float, name: str, status: str) -> float:
    if not math.isfinite(value):
        raise WireError(f"{ESTIMATES.name}: {name} of {status} is {value}, but must be finite")
    return value
