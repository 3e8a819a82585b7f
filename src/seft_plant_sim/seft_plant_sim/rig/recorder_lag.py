"""How far the recorder is behind a rig that keeps no time, and so can wait for it."""

from seft_msgs_py.node.realtime import AwakeClock
from seft_msgs_py.wire.messages import decode_diagnostics
from seft_msgs_py.wire.outcome import RECORDED, RECORDER

MOST = 3072
"""Steps: three quarters of what queues hold. The recorder tells five times a second where it is."""


class RecorderLag:
    """Follows what the recorder says of itself.

    Parameters
    ----------
    patience : float
        Silence after which it is waited for no more, s: whether a test goes on without it is the
        supervisor's to say.
    """

    def __init__(self, patience: float) -> None:
        self._patience, self._awake = patience, AwakeClock()
        self._heard_at = -patience
        self._recorded = 0

    def hear(self, raw: bytes, _: int) -> None:
        """Take in the diagnostics of a node."""
        for status in decode_diagnostics(raw)[1]:
            if status.name == RECORDER:
                self._heard_at = self._awake.time()
                self._recorded = int(status.number(RECORDED) or 0)

    def reset(self) -> None:
        """Begin a test."""
        self._recorded = 0

    def is_large(self, step: int) -> bool:
        """Tell whether the rig should wait after a step until more is recorded."""
        if step - self._recorded < MOST:
            return False
        return self._awake.time() - self._heard_at < self._patience
