"""Many tasks on all cores, in forked copies of the process, and one after another behind a program's back."""

import multiprocessing
import os
import signal
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import cache, wraps
from multiprocessing.pool import Pool
from typing import Any, Generic, ParamSpec, TypeVar

import warp as wp
from threadpoolctl import threadpool_limits

T = TypeVar("T")
R = TypeVar("R")
P = ParamSpec("P")

_work: list[tuple[Callable[[Any], Any], list[Any]]] = []  # of a copy


def mapped(task: Callable[[T], R], items: Iterable[T], *, fork: bool = True) -> list[R]:
    """What a task makes of every item, in their order.

    Copies know all that the process knows, but what they change is lost. They make none themselves.

    Args:
        task: makes what can be pickled.
        items: in the order in which they are begun, the longest first.
        fork: whether the process may be copied; one that uses a GPU may not.

    Raises:
        Exception: what the first task in order raises that fails.
    """
    todo = list(items)
    if copies(len(todo), fork=fork) == 1:
        return [task(item) for item in todo]
    with _pool(task, todo) as pool:
        return list(pool.imap(_done, range(len(todo))))


def unordered(task: Callable[[T], R], items: Iterable[T], *, fork: bool = True) -> Iterator[R]:
    """The same as they come, an exception too; each task in a copy of its own, memory and all."""
    todo = list(items)
    if copies(len(todo), fork=fork) == 1:
        yield from map(task, todo)
        return
    with _pool(task, todo, each=1) as pool:
        yield from pool.imap_unordered(_done, range(len(todo)))


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


def _pool(task: Callable[[Any], Any], items: list[Any], each: int | None = None) -> Pool:
    count = copies(len(items))
    return multiprocessing.get_context("fork").Pool(count, _begin, (task, items), each)


def _begin(task: Callable[[Any], Any], items: list[Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process itself ends its copies
    _work.append((task, items))


def _done(n: int) -> Any:
    task, items = _work[-1]
    return task(items[n])


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
