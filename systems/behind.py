"""Systems whose heavy work is done behind their ports."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pydrake.common.value import Value
from pydrake.systems.framework import (
    CacheEntry,
    Context,
    EventStatus,
    LeafSystem,
    State,
    ValueProducer,
)

from form_drake.workers import Newest


def steps_between(rate: float, period: float) -> int:
    """Steps of ``period`` [s] from one event to the next, that come at ``rate`` [Hz] or a little faster.

    Raises:
        ValueError: they come faster than the steps.
    """
    if not rate * period < 1.0 + 1e-6:
        raise ValueError(
            f"{rate:g} Hz, every {1.0 / rate:g} s, is more often than the material steps, every {period:g} s"
            " (solver.period)"
        )
    return int(1.0 / (rate * period) + 2e-6)


def remembered(system: LeafSystem, name: str, made: Callable[[Context], Any]) -> CacheEntry:
    """What is made of a Context once, until something in it changes."""
    producer = ValueProducer(
        allocate=lambda: Value[object](None),
        calc=lambda context, out: out.set_value(made(context)),
    )
    return system.DeclareCacheEntry(name, producer, {system.all_sources_ticket()})


@dataclass(frozen=True)
class Result:
    """What the newest finished work has made; never written again.

    Attributes:
        time: stamp of what it was made from [s]; NaN: nothing is finished yet.
        value: made of it; None: nothing is finished yet.
        age: time since that stamp [s].
        skipped: stamps of what was not worked on, because something newer came first or its parts
            were not of one moment [s].
    """

    time: float = np.nan
    value: Any = None
    age: float = np.nan
    skipped: tuple[float, ...] = ()

    def __deepcopy__(self, memo: object) -> "Result":
        return self

    def without(self, time: float) -> "Result":
        """The same with one more stamp that was skipped."""
        return replace(self, skipped=(*self.skipped, time))


@dataclass(frozen=True)
class _Kept:
    """State: what is finished, the memory of the work, and the stamp of what was given to it last."""

    result: Result = Result()
    memory: Any = None
    given: float = -np.inf

    def __deepcopy__(self, memo: object) -> "_Kept":
        return self


class Behind(LeafSystem):
    """Looks for something newer at even times, and works on it.

    If it waits, the output is that of the newest input there is, and all memory is in the Context: a
    clone of it goes on alike, and no answer depends on the speed of the machine. If it does not, a
    thread of its own works on the newest input; the output is what was finished last, with its age.
    That thread belongs to the system: two Contexts cannot share it.

    Ports: out ``port`` (``Result``). What derives from this declares inputs, ``newest`` and ``worked``.

    Args:
        port: name of the output.
        period: of the looks, a step of the simulation [s].
        every: steps from one look to the next.
        begin: step of the first one.
        wait: see above.
    """

    def __init__(
        self, port: str, *, period: float, every: int = 1, begin: int = 0, wait: bool = True
    ):
        super().__init__()
        self._period, self._every, self._begin, self._wait = period, every, begin, wait
        self._thread: Newest[tuple[float, Any, Any], tuple[float, Any]]  # from the first input on
        self._kept = self.DeclareAbstractState(Value[object](_Kept()))
        self._now = remembered(self, "now", self._advanced)
        self.DeclareAbstractOutputPort(port, lambda: Value[object](None), self._calc)
        # at multiples of the plant's period: what is computed as begin + n every would fall beside it
        self.DeclarePeriodicUnrestrictedUpdateEvent(period, 0.0, self._update)

    def newest(self, context: Context, after: float) -> tuple[float, Any | None] | None:
        """The newest input and its stamp [s], if that is after another one.

        Where its parts are not of one moment, a stamp and None.
        """
        raise NotImplementedError

    def worked(self, memory: Any, time: float, given: Any) -> tuple[Any, Any]:
        """Memory and value after work on an input; may be called from a thread, looks at no Context."""
        raise NotImplementedError

    def result(self, context: Context) -> Result:
        """What is put out now."""
        kept = self._now.Eval(context) if self._wait else self._state(context)
        found: Result = kept.result
        return replace(found, age=context.get_time() - found.time)

    def _state(self, context: Context) -> _Kept:
        found: _Kept = context.get_abstract_state(int(self._kept)).get_value()
        return found

    def _calc(self, context: Context, output: Value) -> None:
        output.set_value(self.result(context))

    def _looks(self, context: Context) -> bool:
        step = round(context.get_time() / self._period) - self._begin
        return step >= 0 and step % self._every == 0

    def conclude(self, context: Context) -> None:
        """Work on the newest input whenever the next look would be, and wait for it.

        For work that waits, or needs no memory.
        """
        state = context.get_mutable_abstract_state(int(self._kept))
        state.set_value(self._caught_up(context))

    def _advanced(self, context: Context) -> _Kept:
        return self._caught_up(context) if self._looks(context) else self._state(context)

    def _caught_up(self, context: Context) -> _Kept:
        """The state with the newest input worked on."""
        kept = self._state(context)
        found = self.newest(context, kept.given)
        if found is None:
            return kept
        time, given = found
        if given is None:
            return replace(kept, result=kept.result.without(time), given=time)
        memory, value = self.worked(kept.memory, time, given)
        return _Kept(replace(kept.result, time=time, value=value), memory, time)

    def _update(self, context: Context, state: State) -> EventStatus:
        if not self._looks(context):
            return EventStatus.DidNothing()
        kept = self._now.Eval(context) if self._wait else self._handed(context)
        state.get_mutable_abstract_state(int(self._kept)).set_value(kept)
        return EventStatus.Succeeded()

    def _handed(self, context: Context) -> _Kept:
        """The state with what has been finished meanwhile; the newest input is handed over."""
        kept = self._state(context)
        result, given, found = kept.result, kept.given, self.newest(context, kept.given)
        if found is not None:
            if given == -np.inf:
                self._thread = Newest(self._work, (np.nan, kept.memory, None))
            given, what = found
            left_out = found if what is None else self._thread.hand((given, what))
            result = result if left_out is None else result.without(left_out[0])
        while given > -np.inf and (done := self._thread.taken()) is not None:
            result = replace(result, time=done[0], value=done[2])
        return _Kept(result, None, given)

    def _work(
        self, before: tuple[float, Any, Any], given: tuple[float, Any]
    ) -> tuple[float, Any, Any]:
        return (given[0], *self.worked(before[1], *given))
