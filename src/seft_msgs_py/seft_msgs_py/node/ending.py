"""How a process is told to end: Ctrl-C, SIGTERM, or its terminal closed."""

import os
import signal
from collections.abc import Callable
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
_OUTPUTS = (1, 2)
Handler = Callable[[int, FrameType | None], None]


def on_ending(handler: Handler) -> dict[signal.Signals, Any]:
    """Have ``handler`` called when this process is told to end; return the handlers of before.

    SIGHUP says that the terminal has been closed. What is written goes nowhere from then on, where
    it would fail before the end has come. It stays ignored where it is (`nohup`).
    """
    terminals = [file for file in _OUTPUTS if os.isatty(file)]

    def told(number: int, frame: FrameType | None) -> None:
        if number == signal.SIGHUP:
            _write_nowhere(terminals)
        handler(number, frame)

    before = {number: signal.getsignal(number) for number in SIGNALS}
    for number in SIGNALS:
        if number != signal.SIGHUP or before[number] is not signal.SIG_IGN:
            signal.signal(number, told)
    return before


def as_before(handlers: dict[signal.Signals, Any]) -> None:
    """Set the handlers again that `on_ending` has given back."""
    for number, handler in handlers.items():
        signal.signal(number, handler)


def _write_nowhere(files: list[int]) -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for file in files:
        os.dup2(nowhere, file)
    os.close(nowhere)
