"""Ctrl-C and SIGTERM, taken where they can be answered."""

import signal
from types import FrameType, TracebackType
from typing import Self

SIGNALS = (signal.SIGINT, signal.SIGTERM)
AT_ONCE = 2  # signals that are remembered: for a soft stop, and for an emergency stop


class Interruption:
    """Remembers Ctrl-C and SIGTERM until it is asked for them; the third one acts at once.

    An exception that a handler raises comes out wherever the program happens to be; within a
    callback that C++ code has called, it is lost, and the test goes on.
    """

    def __init__(self) -> None:
        self._seen = 0
        self._given = 0
        self._before: dict[int, object] = {}

    def __enter__(self) -> Self:
        self._before = {number: signal.signal(number, self._remember) for number in SIGNALS}
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def check(self) -> None:
        """Give way to what was asked for, once for each time.

        Raises
        ------
        KeyboardInterrupt
            If a signal came since the last one was given way to.
        """
        if self._seen > self._given:
            self._given += 1
            raise KeyboardInterrupt

    def _remember(self, number: int, frame: FrameType | None) -> None:
        self._seen += 1
        if self._seen > AT_ONCE:
            raise KeyboardInterrupt
