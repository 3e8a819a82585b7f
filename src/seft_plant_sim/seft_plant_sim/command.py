"""The newest command of a topic that a rig may apply."""

import numpy as np
from seft_msgs_py.errors import WireError
from seft_msgs_py.trajectory import Floats, TrajectoryCodec


class Command:
    """Takes the messages of one topic, and keeps the newest that fits the test.

    A message that is refused leaves what is held as it is: to the rig, its command is missing.

    Parameters
    ----------
    codec : TrajectoryCodec
        Of the topic.
    limit : float
        Largest magnitude on any axis, in the topic's unit.

    Attributes
    ----------
    step : int
        Step of the command; -1 where none has come.
    value : ndarray
        The command, shape (n,); zero where none has come.
    current : int
        Step of the rig's last sample: no later one can have been answered.
    """

    def __init__(self, codec: TrajectoryCodec, limit: float) -> None:
        self.codec = codec
        self._limit = limit
        self.reset()

    def reset(self) -> None:
        """Back to no drive, before the first sample of a test."""
        self.step = self.current = -1
        self.value: Floats = np.zeros(len(self.codec.axes))

    def take(self, raw: bytes) -> None:
        """Take a message.

        Raises
        ------
        WireError
            If it is no command of these axes, is not finite or beyond the limit, answers a
            sample that has not been taken, or is not newer than the one that is held.
        """
        step, values = self.codec.decode(raw)
        name = self.codec.topic.name
        if step > self.current:
            raise WireError(f"{name} of step {step}, but the rig is at step {self.current}")
        if step <= self.step:
            raise WireError(
                f"{name} of step {step} after that of step {self.step}: stale, duplicated or out "
                "of order"
            )
        value = values[0, 0]
        for axis, number in zip(self.codec.axes, value.tolist(), strict=True):
            if not abs(number) <= self._limit:
                unit = self.codec.topic.units[0]
                raise WireError(
                    f"{name} of step {step} is {number:g} {unit} on axis {axis}, beyond the "
                    f"limit of {self._limit:g} {unit}"
                )
        self.step = step
        self.value = value
