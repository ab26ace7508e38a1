"""Many tasks on all cores, in forked copies of the process, and one after another behind a program's back."""

import multiprocessing
import os
import signal
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache, wraps
from multiprocessing.connection import Connection, wait
from multiprocessing.context import ForkProcess
from typing import Any, Generic, ParamSpec, TypeVar, cast

import warp as wp
from threadpoolctl import threadpool_limits

T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")

TIDIES = 10.0  # [s] that a copy has to end in


@dataclass(frozen=True)
class Failed:
    """What a task in a copy has raised, or how the copy ended."""

    error: Exception


def mapped(task: Callable[[T], R], items: Iterable[T], *, fork: bool = True) -> list[R]:
    """What a task makes of every item, in their order.

    Copies know all that the process knows, but what they change is lost. They make none themselves.

    Args:
        task: makes what can be pickled.
        items: in the order in which they are begun, the longest first.
        fork: whether the process may be copied; one that uses a GPU may not.

    Raises:
        Exception: what the first task in order raises that fails.
        MemoryError: a copy was killed.
    """
    todo = list(items)
    if copies(len(todo), fork=fork) == 1:
        return [task(item) for item in todo]
    made = dict(_copied(task, todo, lasting=True))
    return [_told(made[n]) for n in sorted(made)]


def unordered(
    task: Callable[[T], R], items: Iterable[T], *, fork: bool = True
) -> Generator[R, None, None]:
    """The same as they come, an exception too; each task in a copy of its own, memory and all."""
    todo = list(items)
    if copies(len(todo), fork=fork) == 1:
        yield from map(task, todo)
        return
    with closing(_copied(task, todo, lasting=False)) as made:
        for _, outcome in made:
            yield _told(outcome)


def single(work: Callable[P, R]) -> Callable[P, R]:
    """A function whose linear algebra runs in one thread.

    Matrices here are small, so that a second thread costs more than it gives; and the last digits of
    an answer do not depend on how many there are.
    """

    @wraps(work)
    def alone(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return work(*args, **kwargs)

    return alone


def forkable() -> bool:
    """Whether this process may be copied: where it can use no GPU."""
    wp.init()  # once for all copies
    return not wp.is_cuda_available()


def copies(count: int, *, fork: bool = True) -> int:
    """How many tasks out of some are made at a time."""
    if not fork or multiprocessing.current_process().daemon:
        return 1
    return max(1, min(count, len(os.sched_getaffinity(0))))


def _copied(
    task: Callable[[T], R], items: Sequence[T], *, lasting: bool
) -> Generator[tuple[int, R | Failed], None, None]:
    """What becomes of items, by number; after a failure none is begun.

    A copy works on one of them, or is ``lasting``: on one after another, with what it has loaded.
    """
    waiting = deque(range(len(items)))
    running = dict[Connection, tuple[int, ForkProcess]]()
    try:
        while waiting or running:
            while waiting and len(running) < copies(len(items)):
                ours, copy = _copy(task, items, list(running))
                running[ours] = _handed(ours, waiting.popleft()), copy
            for ours in cast(list[Connection], wait(list(running))):
                n, copy = running[ours]
                outcome = _received(ours, copy)
                if isinstance(outcome, Failed):
                    waiting.clear()
                if lasting and waiting:
                    running[ours] = _handed(ours, waiting.popleft()), copy
                else:
                    del running[ours]
                    ours.close()
                yield n, outcome
    finally:
        _end([copy for _, copy in running.values()])


def _handed(end: Connection, n: int) -> int:
    """The number of an item, handed to a copy; that one has ended is heard when its work is awaited."""
    with suppress(BrokenPipeError, ConnectionResetError):
        end.send(n)
    return n


def _copy(
    task: Callable[[Any], Any], items: Sequence[Any], others: Sequence[Connection]
) -> tuple[Connection, ForkProcess]:
    """A copy of this process that works on items, and the end of its pipe."""
    fork = multiprocessing.get_context("fork")
    ours, theirs = fork.Pipe()
    copy = fork.Process(target=_work, args=(theirs, (ours, *others), task, items), daemon=True)
    copy.start()
    theirs.close()  # so that the end of the copy is that of the pipe
    return ours, copy


def _work(
    end: Connection,
    others: Sequence[Connection],
    task: Callable[[Any], Any],
    items: Sequence[Any],
) -> None:
    """Work in a copy on items whose numbers come, until none does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process itself ends its copies
    signal.signal(signal.SIGTERM, _tidy)  # and they what they have begun
    for other in others:  # so that the end of the process is that of the pipe
        other.close()
    with suppress(EOFError, BrokenPipeError):
        while True:
            n = end.recv()
            try:
                outcome = task(items[n])
            except Exception as error:
                error.add_note(traceback.format_exc())
                outcome = Failed(error)
            end.send(outcome)


def _tidy(*_: object) -> None:
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    sys.exit(1)


def _end(running: Sequence[ForkProcess]) -> None:
    """End copies; one that is about to wait for something may not hear it the first time."""
    until = time.monotonic() + TIDIES
    while time.monotonic() < until and any(copy.is_alive() for copy in running):
        for copy in running:
            copy.terminate()
            copy.join(0.1)
    for copy in running:
        copy.kill()


def _received(end: Connection, copy: ForkProcess) -> Any:
    try:
        return end.recv()
    except (EOFError, ConnectionResetError):
        copy.join()
    if copy.exitcode == -signal.SIGKILL:
        return Failed(MemoryError("a copy of this process was killed"))
    return Failed(
        RuntimeError(f"a copy of this process ended with {copy.exitcode} before its work")
    )


def _told(outcome: R | Failed) -> R:
    if isinstance(outcome, Failed):
        raise outcome.error
    return outcome


def parted(work: Callable[[slice], None], count: int, least: int) -> None:
    """Work on the parts of a range, each in a thread of its own, as far as there are cores.

    Args:
        work: on a part; for compiled code that holds no lock of the interpreter.
        count: length of the range.
        least: length of a part that is worth a thread.
    """
    parts = max(1, copies(count // least))
    if parts == 1:
        return work(slice(0, count))
    ends = [count * n // parts for n in range(parts + 1)]
    first, *others = map(slice, ends[:-1], ends[1:])
    begun = [_threads(os.getpid()).submit(work, part) for part in others]
    work(first)
    for part in begun:
        part.result()


@cache
def _threads(_process: int) -> ThreadPoolExecutor:
    """Threads of this process: a copy has none of those that it was copied with."""
    return ThreadPoolExecutor(len(os.sched_getaffinity(0)))


class Newest(Generic[R, T]):
    """Works in a thread on the newest of what it is handed; what it cannot keep up with is left out.

    Args:
        work: makes the next state of the last one and of what was handed over.
        first: the state to begin with.
    """

    def __init__(self, work: Callable[[R, T], R], first: R):
        self._work, self._state = work, first
        self._wake = threading.Condition()
        self._waiting: deque[T] = deque(maxlen=1)
        self._done: deque[R | Exception] = deque()
        threading.Thread(target=self._run, daemon=True).start()

    def hand(self, item: T) -> T | None:
        """Hand over; what it takes the place of, on which nothing will be done."""
        with self._wake:
            left_out = self._waiting.pop() if self._waiting else None
            self._waiting.append(item)
            self._wake.notify()
        return left_out

    def taken(self) -> R | None:
        """The state after the oldest work that is done and was not taken yet.

        Raises:
            Exception: what the work has raised; nothing is done after it.
        """
        found = self._done.popleft() if self._done else None
        if isinstance(found, Exception):
            raise found
        return found

    def _run(self) -> None:
        while True:
            with self._wake:
                while not self._waiting:
                    self._wake.wait()
                item = self._waiting.pop()
            try:
                self._state = self._work(self._state, item)
            except Exception as error:
                self._done.append(error)
                return
            self._done.append(self._state)
