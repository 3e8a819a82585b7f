"""Virtual time: coroutines of which exactly one runs, and a clock that jumps to the next event.

A task is a greenlet: a coroutine that may be left from within any call, so that the code of a node
needs no ``await``. Whatever blocks calls `Scheduler.block`, which gives the turn to the task with
the earliest wake-up; equal ones take turns in the order in which they began to wait or were woken.
Computing takes no time, unless somebody says so by `VirtualClock.sleep`.
"""

import heapq
import itertools
import math
from collections.abc import Callable

from greenlet import getcurrent, greenlet

NEVER = 2**62  # ns
MAX_TURNS = 200_000  # without any progress of time: somebody polls for ever


def ns(seconds: float) -> int:
    """Nanoseconds, rounded up: a wait of any length makes progress."""
    return max(1, math.ceil(seconds * 1e9)) if seconds < 1e9 else NEVER


class Unwound(BaseException):
    """Ends a task where it waits."""


class Task:
    """What runs only when it has the turn.

    Attributes
    ----------
    name : str
        Of the nodes that it runs.
    frozen_until : int
        Time before which it gets no turn, ns.
    error : BaseException or None
        What ended it.
    """

    def __init__(self, name: str, order: int, routine: greenlet) -> None:
        self.name, self.order = name, order
        self.ready_at = self.frozen_until = 0
        self.is_wakeable = self.is_ending = False
        self.error: BaseException | None = None
        self.routine = routine

    def wakes_at(self) -> int:
        """Time of its next turn, ns."""
        return max(self.ready_at, self.frozen_until)


class Scheduler:
    """Gives turns. What makes it is the first task.

    Attributes
    ----------
    now : int
        Virtual time, ns.
    current : Task
        The task that has the turn.
    """

    def __init__(self) -> None:
        self.now = 0
        self._turns_at_once, self._count = 0, itertools.count()
        self._events: list[tuple[int, int, Callable[[], None]]] = []
        self.current = self._first = Task("driver", next(self._count), getcurrent())
        self._tasks = [self.current]

    def start(self, name: str, run: Callable[[], None]) -> Task:
        """Start a task; it gets its first turn when the caller blocks."""

        def body(_: object = None) -> None:  # a greenlet that ends passes its result on
            try:
                if not task.is_ending:
                    run()
            except Unwound:
                pass
            except BaseException as error:
                task.error = error
            self._tasks.remove(task)
            task.routine.parent = self._next().routine  # where a greenlet goes that ends

        task = Task(name, next(self._count), greenlet(body))
        task.ready_at = self.now
        self._tasks.append(task)
        return task

    def is_alive(self, task: Task) -> bool:
        """Say whether a task has not ended."""
        return task in self._tasks

    def after(self, delay_ns: int, act: Callable[[], None]) -> None:
        """Do something after a time, in whoever's turn; at once if that is 0."""
        if delay_ns:
            heapq.heappush(self._events, (self.now + delay_ns, next(self._count), act))
        else:
            act()

    def block(self, until_ns: int, wakeable: bool = False) -> None:
        """Let others run until a time, or until this task is woken."""
        task = self.current
        task.ready_at, task.order, task.is_wakeable = until_ns, next(self._count), wakeable
        if (following := self._next()) is not task:
            following.routine.switch()
        if task.is_ending:
            raise Unwound

    def wake(self, task: Task) -> None:
        """End a task's waiting."""
        if task.is_wakeable and task.ready_at > self.now:
            task.ready_at, task.order = self.now, next(self._count)

    def unwind(self, task: Task) -> None:
        """End a task where it waits: `Unwound` is raised there."""
        task.is_ending, task.ready_at, task.frozen_until = True, self.now, 0

    def _next(self) -> Task:
        """Let time go on to the next turn; give the task that has it."""
        before = self.now
        while True:
            task = min(self._tasks, key=lambda each: (each.wakes_at(), each.order))
            at = task.wakes_at()
            if not self._events or self._events[0][0] > max(at, self.now):
                break
            due, _, act = heapq.heappop(self._events)
            self.now = max(self.now, due)
            act()
        self.now = max(self.now, at)
        self._turns_at_once = self._turns_at_once + 1 if self.now == before else 0
        if self._turns_at_once > MAX_TURNS:
            task, self._turns_at_once = self._first, 0
            task.error = RuntimeError(f"{self.current.name} polls for ever at {self.now} ns")
        self.current = task
        return task


class VirtualClock:
    """The clock of a `Scheduler`; see `seft_msgs_py.node.transport.Clock`."""

    START, EPOCH_NS = 10_000.0, 1_800_000_000_000_000_000

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler

    def monotonic(self) -> float:
        """Time since some moment, s."""
        return self.START + self._scheduler.now * 1e-9

    elapsed = monotonic

    def time_ns(self) -> int:
        """Wall-clock time in ns; the graph starts at the same one each time."""
        return self.EPOCH_NS + self._scheduler.now

    def sleep(self, seconds: float) -> None:
        """Let others run."""
        self._scheduler.block(self._scheduler.now + ns(seconds))

    def wait(self, seconds: float) -> None:
        """Sleep, unless woken."""
        self._scheduler.block(self._scheduler.now + ns(seconds), wakeable=True)
