"""How long a rig has been without a new command, also where it stood still itself."""

import time

from seft_msgs_py.wire.topics import LoopTopic


def elapsed() -> float:
    """Time that goes on while this process is stopped and while its machine sleeps, s."""
    return time.clock_gettime(time.CLOCK_BOOTTIME)


class CommandWatch:
    """Looks at the end of each period whether the rig may go on with the command that it holds.

    A valve stays where it was while the rig's process or its machine stands still: what answers
    a sample from before that is no answer any more, though it is the newest there is. So time
    counts, not steps. Times are those of `elapsed`.

    Parameters
    ----------
    topic : LoopTopic
        Of the commands.
    period : float
        Of the samples, s.
    timeout : float
        Longest time without a new command, s; a period at least.
    """

    def __init__(self, topic: LoopTopic, period: float, timeout: float) -> None:
        self._topic, self._period, self._timeout = topic, period, timeout
        self.begin(0.0)

    def begin(self, now: float) -> None:
        """Begin with the first sample of a test."""
        self._answered, self._fresh_at = -1, now

    def fault(self, now: float, step: int, answered: int, *, in_vain: bool = False) -> str:
        """Say why the test must end here, before a command is applied; empty if it may go on.

        Parameters
        ----------
        now : float
            Time, s.
        step : int
            Step of the last sample.
        answered : int
            Last step whose command is settled, -1 where none is.
        in_vain : bool
            Whether the rig has waited for it for as long as it may, and put off its next sample.
        """
        period, timeout = self._period, self._timeout
        behind = step - answered
        is_new = answered > self._answered or behind <= 0
        without = now - self._fresh_at - is_new * period
        if is_new:
            self._answered, self._fresh_at = answered, now - max(behind, 0) * period
        if without <= max(timeout, period) + period / 2 and not in_vain:
            return ""
        name = self._topic.name
        if behind * period <= timeout and not in_vain:
            return (
                f"the rig stood still for {without:.3g} s, and its valve with it: its process or "
                f"its host was stopped or overloaded ({timeout:g} s without a new {name} are "
                "allowed)"
            )
        last = f"(the last is of step {answered})"
        return f"no new {name} for {timeout:g} s {last}; is {self._topic.publisher} running?"
