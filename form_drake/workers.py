"""Many tasks on all cores: forked copies of the process, so that only results need be pickled."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

T = TypeVar("T")
R = TypeVar("R")

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
    count = min(len(todo), len(os.sched_getaffinity(0)))
    if count < 2 or not fork or multiprocessing.current_process().daemon:
        return [task(item) for item in todo]
    context = multiprocessing.get_context("fork")
    with context.Pool(count, _begin, (task, todo)) as pool:
        return list(pool.imap(_done, range(len(todo))))


def _begin(task: Callable[[Any], Any], items: list[Any]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the process itself ends its copies
    _work.append((task, items))


def _done(n: int) -> Any:
    task, items = _work[-1]
    return task(items[n])
