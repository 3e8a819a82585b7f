"""Which command a rig has applied after each sample, where some were missed."""

from collections.abc import Mapping
from itertools import combinations, product

import numpy as np
from seft_msgs_py.errors import InputError
from seft_msgs_py.wire.topics import REFERENCE_FORCE, VALVE_COMMAND
from seft_msgs_py.wire.trajectory import Floats
from seft_plant_sim.rig.rig import Rig

from seft_ros.recording.record import Series
from seft_ros.replay.recorded import Recorded

REACH = 20
"""Steps after a choice within which a wrong one shows in the bits of the states."""
MOST = 300_000
"""Steps of the rig that are tried."""
END = 2**62
"""A step that no test reaches."""


class HeldCommands:
    """Commands that a recorded rig applied, a missed one holding the last.

    Of several missed in a row some came late, and were the last for the next: which, no message
    says. The times of recording tell it first; where the rig, with the recorded parameters, then
    does not give the recorded states, other ways are tried until it does.

    Parameters
    ----------
    recorded : Recorded
        A test.
    rig : Rig
        With the recorded parameters; it is stepped only where commands were missed in a row.
    states : Series
        The recorded states, as far as it is known which commands were missed.

    Attributes
    ----------
    values : ndarray
        What was applied after each sample but the last of N, shape (N - 1, n), in the unit of
        what drives the rig.
    unsure : list of int
        Steps whose command the states do not confirm.

    Raises
    ------
    InputError
        If a command that was not missed is not in the bag.
    """

    def __init__(self, recorded: Recorded, rig: Rig, states: Series) -> None:
        topic = VALVE_COMMAND if rig.drive == VALVE_COMMAND.name else REFERENCE_FORCE
        series, record = recorded.series(topic), recorded.record
        self._rig, self._states = rig, states
        self._values = dict(zip(series.steps.tolist(), series.values[:, -1], strict=True))
        self._none = np.zeros(len(record.experiment.axes))
        self._missed = set(record.missed_steps)
        self._steps = int(self._states.steps[-1])
        self._in_time = _newest_by_time(series, states)
        for step in range(self._steps):
            if step in self._values or step in self._missed:
                continue
            if record.missed is None:
                self._missed.add(step)
                continue
            raise InputError(
                f"the bag lacks {topic.name} of step {step}, which the rig did not miss: what it "
                "applied is not known"
            )
        self.unsure: list[int] = []
        self._taken = 0
        applied = self._search()
        values = [self._values.get(at, self._none) for at in applied]
        self.values: Floats = np.array(values).reshape(self._steps, len(self._none))

    def _search(self) -> list[int]:
        """Mend the first wrong state by one choice before it, again and again."""
        chosen: dict[int, int] = {}
        applied, choices = self._apply(chosen)
        if not choices:
            return applied
        wrong = self._first_wrong(applied)
        while wrong < END:
            mended = self._mended(chosen, choices, wrong)
            if mended is None:
                self.unsure = [step for step in choices if step >= wrong - REACH]
                break
            chosen, applied, choices, wrong = mended
        return applied

    def _mended(
        self, chosen: dict[int, int], choices: dict[int, list[int]], wrong: int
    ) -> tuple[dict[int, int], list[int], dict[int, list[int]], int] | None:
        """Find the other choice, or the two, with which the states are right for longest."""
        near = [step for step in choices if wrong - REACH <= step < wrong][::-1]
        best = None
        for count in (1, 2):
            for steps in combinations(near, count):
                for ways in product(*(range(len(choices[step])) for step in steps)):
                    other = {at: told for at, told in chosen.items() if at < steps[-1]}
                    other |= dict(zip(steps, ways, strict=True))
                    applied, further = self._apply(other)
                    found = self._first_wrong(applied)
                    if found > wrong:
                        wrong, best = found, (other, applied, further, found)
                    if self._taken > MOST:
                        return best
            if best is not None:
                return best
        return None

    def _apply(self, chosen: Mapping[int, int]) -> tuple[list[int], dict[int, list[int]]]:
        """Step of the command applied after each sample, and where there was a choice."""
        newest, applied, choices = -1, [], {}
        for step in range(self._steps):
            if step not in self._missed:
                newest = step
            else:
                late = [at for at in range(newest + 1, step) if at in self._values]
                if late:
                    told = max((at for at in late if at <= self._in_time.get(step, -1)), default=-1)
                    first = told if told >= 0 else newest
                    choices[step] = [first, *(at for at in (newest, *late) if at != first)]
                    which = chosen.get(step, 0)
                    newest = choices[step][min(which, len(choices[step]) - 1)]
            applied.append(newest)
        return applied, choices

    def _first_wrong(self, applied: list[int]) -> int:
        """First step whose recorded state the rig does not give; `END` if it gives all."""
        measured = self._rig.reset()
        at = 0
        for step, state in zip(self._states.steps.tolist(), self._states.values, strict=True):
            while at < step:
                measured = self._rig.step(self._values.get(applied[at], self._none))
                at += 1
            if measured.tobytes() != state.tobytes():
                break
        else:
            step = END
        self._taken += at
        return int(step)


def _newest_by_time(commands: Series, states: Series) -> dict[int, int]:
    """Step -> newest command that was recorded before the state after it."""
    if commands.received_ns is None or states.received_ns is None or not len(commands.steps):
        return {}
    before = np.searchsorted(np.maximum.accumulate(commands.received_ns), states.received_ns)
    known = np.where(before > 0, commands.steps[np.maximum(before, 1) - 1], -1)
    return dict(zip((states.steps - 1).tolist(), known.tolist(), strict=True))
