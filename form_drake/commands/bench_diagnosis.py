"""``form-drake bench nulls | effects | station | blind``: what a diagnosis is worth."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from form_drake.bench import blind, blind_score, blind_table, effects, nulls, station
from form_drake.bench.blind_cases import Probes
from form_drake.commands.bench_cases import Cases
from form_drake.commands.diagnose import Diagnose
from form_drake.commands.output import emit, say
from form_drake.effects import catalogue


@dataclass(frozen=True, kw_only=True)
class Nulls(Cases):
    """Scores of a diagnosis where nothing is missing, on data from a finer grid than the twin's, and from
    finite elements of tests/oracles, which need a checkout.
    """

    draws: int = nulls.DRAWS
    """Draws of noise on every specimen."""
    like: tuple[Path, ...] = ()
    """Recordings whose scenes take the place of the specimens, for diagnose --nulls."""
    material: Path | None = None
    """Of the specimen of these, as a diagnosis has found it (YAML)."""
    dx: float | None = None
    """Grid spacing of the twin of these [m]; default: as in diagnose."""
    force: str = "sensor"
    """Source of their force, as in diagnose."""
    effects: Path | None = None
    """Python file with effects of your own to score too; it is executed."""

    def run(self) -> None:
        """Run the bench."""
        if self.draws < 1:
            raise ValueError(f"--draws {self.draws}: at least one is wanted")
        if self != replace(Nulls(), out=self.out, only=self.only, json=self.json, draws=self.draws):
            inputs = (*self.like, self.material, self.effects)
            self.finish("nulls", self._like(), nulls.table, inputs)
        else:
            self.finish("nulls", partial(nulls.run_nulls, draws=self.draws), nulls.table)

    def _like(self) -> Callable[..., dict[str, Any]]:
        """The bench on recordings of one's own.

        Raises:
            ValueError: they, or the material, are not given or cannot be read.
        """
        if not self.like or self.material is None:
            raise ValueError(
                "--like RECORDING... and --material MATERIAL.yaml are wanted together: scenes, and what is"
                " simulated in them"
            )
        like = Diagnose(self.like, self.material, dx=self.dx, force=self.force)
        every = catalogue(self.effects)
        read, _, model = like.opened(every)
        assert model is not None  # of the material
        return partial(
            nulls.run_like,
            read,
            model,
            effects=list(every.values()),
            dx=self.dx,
            draws=self.draws,
            inputs=[self.effects] if self.effects else [],
        )


@dataclass(frozen=True, kw_only=True)
class Effects(Cases):
    """Every effect, at three sizes, found again in a press and a shake; none where none acts."""

    def run(self) -> None:
        """Run the bench."""
        self.finish("effects", effects.run_effects, effects.table)


@dataclass(frozen=True, kw_only=True)
class Station(Cases):
    """Effects hidden in the station, sought in what its probes record."""

    def run(self) -> None:
        """Run the bench."""
        self.finish("station", station.run_station, station.table)


@dataclass(frozen=True)
class Blind:
    """Diagnose cases whose truth is sealed; with --score and --key, say what the verdicts are worth."""

    seal: Path
    """File with the seal: the SHA-256 of ids, seeds, kinds and names of effects in the key, as docs/sealed.md
    tells."""
    cases: Path | None = None
    """Folder of cases (ID/press.h5, shake.h5 and heldout.h5), or a list of seeds of this project's
    own generator (tests/oracles/hidden_effects_set.py), which needs a checkout."""
    out: Path | None = None
    """File of verdicts, which grows by a line for each case; default: runs/bench-blind/blind.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose ids contain one of these."""
    press_alone: bool = False
    """Read the press without the shake; its verdicts want a file of their own."""
    faces: bool = False
    """Read what points on two sides and the force show alone; a file of their own too."""
    score: Path | None = None
    """File of verdicts to score; no case is run."""
    key: Path | None = None
    """The key, to score with."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench, or score what it found."""
        if (self.score is None) != (self.key is None):
            raise ValueError("--score and --key are wanted together: the verdicts, and the truth")
        if self.score is not None and self.key is not None:
            if self != Blind(self.seal, score=self.score, key=self.key, json=self.json):
                raise ValueError(
                    "--cases, --out, --only, --press-alone and --faces are for running cases: leave them out"
                    " with --score"
                )
            told = blind_score.score(self.score, self.key, self.seal)
            emit(blind_table.table(told), told, as_json=self.json)
            return
        if self.cases is None:
            raise ValueError("no --cases: a folder of cases, or a list of seeds")
        out = self.out or Path("runs/bench-blind/blind.json")
        if self.press_alone and self.faces:
            raise ValueError("--press-alone and --faces are for runs of their own: choose one")
        probes: Probes = "press" if self.press_alone else "faces" if self.faces else "all"
        result = blind.run_blind(self.cases, self.seal, out, only=self.only, probes=probes)
        emit(blind.table(result), result, as_json=self.json)
        say(f"written: {out}")
