"""Tasks on all cores: what forked copies make comes back in order, and what they raise."""

import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

from form_drake.workers import Newest, mapped, single, unordered

CORES = len(os.sched_getaffinity(0))


def test_what_copies_make_comes_back_in_order():
    told = []  # copies know what this process knows, and their changes are lost

    def task(n):
        told.append(n)
        return n**2, os.getpid()

    made = mapped(task, range(7))
    assert [square for square, _ in made] == [n**2 for n in range(7)]
    if CORES > 1:
        assert told == [] and os.getpid() not in {pid for _, pid in made}


def test_what_may_not_be_copied_is_not():
    assert {pid for pid in mapped(lambda n: os.getpid(), range(3), fork=False)} == {os.getpid()}
    assert mapped(lambda n: os.getpid(), [1]) == [os.getpid()]


def test_copies_make_none_themselves():
    def task(n):
        return os.getpid(), mapped(lambda m: os.getpid(), range(2))

    for own, inner in mapped(task, range(2)):
        assert inner == [own, own]


def test_linear_algebra_keeps_to_one_thread_inside_and_to_what_it_had_outside():
    def threads():
        np.linalg.inv(np.eye(2))
        return {pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"}

    @single
    def task():
        """What it does."""
        return threads()

    with threadpool_limits(2, user_api="blas"):
        outside = threads()
        assert task() == {1} and threads() == outside
    assert task.__doc__ == "What it does."


def test_the_first_in_order_that_fails_is_told():
    def task(n):
        time.sleep(0.2 * (n == 0))  # another fails before it
        raise ValueError(f"{n} is no good")

    with pytest.raises(ValueError, match="0 is no good"):
        mapped(task, range(2))


def test_what_is_made_comes_at_once():
    def task(n):
        time.sleep(0.4 * (n == 0))
        return n

    made = list(unordered(task, range(3)))
    assert sorted(made) == [0, 1, 2] and (made[-1] == 0 or CORES == 1)
    assert list(unordered(task, range(3), fork=False)) == [0, 1, 2]


several = pytest.mark.skipif(CORES == 1, reason="nothing is copied on one core")


@several
@pytest.mark.parametrize(("name", "kind"), [("SIGKILL", MemoryError), ("SIGHUP", RuntimeError)])
def test_a_copy_that_is_killed_is_told_and_not_waited_for(name, kind):
    def task(n):
        if n == 1:
            os.kill(os.getpid(), getattr(signal, name))
        return n

    with pytest.raises(kind, match="a copy of this process"):
        mapped(task, range(4))


@several
def test_where_one_comes_from_is_in_its_note():
    def task(n):
        raise ValueError("no good")

    with pytest.raises(ValueError) as failed:
        mapped(task, range(2))
    assert "in task" in failed.value.__notes__[0]


@several
def test_what_copies_have_begun_ends_with_them(tmp_path, monkeypatch):
    """Programs too, and temporary folders; the caller goes on at once."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def task(n):
        with TemporaryDirectory():
            if n:
                while len(list(tmp_path.glob("*/begun"))) < 1:
                    time.sleep(0.01)
                return n
            with TemporaryDirectory() as folder:
                late = "import pathlib, time; pathlib.Path('begun').touch(); time.sleep(60)"
                subprocess.run([sys.executable, "-c", late], cwd=folder, check=True)

    begun = time.monotonic()
    made = unordered(task, range(2))
    assert next(made) == 1
    made.close()
    assert time.monotonic() - begun < 30.0 and not list(tmp_path.iterdir())


@several
def test_each_task_begins_with_a_memory_of_its_own():
    told = []

    def task(n):
        told.append(n)
        return len(told)

    assert list(unordered(task, range(5))) == [1] * 5


def test_the_newest_is_worked_on_and_what_it_replaces_is_told():
    gate = threading.Event()

    def add(total, item):
        gate.wait(10.0)
        if item < 0:
            raise ValueError("below nothing")
        return total + item

    worker = Newest(add, 100)
    assert worker.taken() is None and worker.hand(1) is None
    while worker._waiting:  # until it is begun
        time.sleep(0.01)
    assert worker.hand(2) is None and worker.hand(3) == 2
    gate.set()
    assert [until(worker), until(worker)] == [101, 104]
    worker.hand(-1)
    with pytest.raises(ValueError, match="below nothing"):
        until(worker)


def until(worker):
    for _ in range(500):
        found = worker.taken()
        if found is not None:
            return found
        time.sleep(0.01)
    raise AssertionError("nothing is done")
