"""What the options of benches have in common."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from form_drake.commands.output import emit, say
from form_drake.files import spare, target, write_json


@dataclass(frozen=True, kw_only=True)
class Cases:
    """Many cases, each kept when it is finished, until all are there."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-NAME/NAME.json, NAME that of the bench. Finished cases stay
    beside it, in NAME.json.cases, and are not run again by the same code."""
    only: tuple[str, ...] = ()
    """Run only cases whose names contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def finish(
        self,
        name: str,
        run: Callable[..., dict[str, Any]],
        table: Callable[[dict[str, Any]], str],
        inputs: Sequence[Path | None] = (),
    ) -> None:
        """Run with ``store``, where finished cases stay, and ``only``; ``inputs`` are not written over."""
        out = target(self.out or Path("runs") / f"bench-{name}" / f"{name}.json")
        spare(out, *inputs)
        store = out.with_name(out.name + ".cases")
        result = run(store=store, only=self.only)
        write_json(out, result)
        emit(table(result), result, as_json=self.json)
        say(f"written: {out}")
