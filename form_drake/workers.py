"""Many tasks on all cores: forked copies of the process, so that only results need be pickled."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterable, Iterator
from multiprocessing.pool import Pool
from typing import Any, TypeVar

import warp as wp

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
