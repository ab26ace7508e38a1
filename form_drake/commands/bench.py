"""``form-drake bench``: every number that the documents state, one command each."""

import os
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm

from form_drake.bench import (
    blind,
    blind_score,
    deformable,
    effects,
    nulls,
    perception,
    positions,
    probes,
    rubber,
    speed,
    table2,
    table2_weak,
    weak_form,
)
from form_drake.bench.curves import recordings
from form_drake.commands.output import emit, say
from form_drake.files import target, write_json
from form_drake.records import write_recording

DATA = "FORM_DRAKE_NCLAW"


def _folder(data: Path | None) -> Path:
    """The folder of the shared NCLaw data.

    Raises:
        ValueError: none is given, or it does not exist.
    """
    if data is None and not os.environ.get(DATA):
        raise ValueError(f"give the folder of the NCLaw data with --data, or set {DATA}")
    folder = data or Path(os.environ[DATA])
    if not folder.is_dir():
        raise ValueError(f"{folder}: no such folder")
    return folder


def _finish(
    name: str,
    out: Path | None,
    run: Callable[[Path], dict[str, Any]],
    table: Callable[[dict[str, Any]], str],
    *,
    whole: bool,
    as_json: bool,
) -> None:
    """Run a bench, write its result; the finished cases of a part of it are kept for the rest."""
    out = target(out or Path("runs") / f"bench-{name}" / f"{name}.json")
    store = out.with_name(out.name + ".cases")
    result = run(store)
    write_json(out, result)
    if whole:
        shutil.rmtree(store, ignore_errors=True)
    emit(table(result), result, as_json=as_json)
    say(f"written: {out}")


@dataclass(frozen=True)
class Table2:
    """The paper's Table II on the shared NCLaw data, with the floors of this solver."""

    data: Path | None = None
    """Folder of the shared NCLaw data; default: the environment variable FORM_DRAKE_NCLAW."""
    method: Literal["step", "weak"] = "step"
    """step: the table; weak: the bias of the weak form on the same data, with the twin offset."""
    out: Path | None = None
    """JSON file to write; default: runs/bench-table2/table2.json, or table2-weak for weak."""
    only: tuple[str, ...] = ()
    """Run only cases whose names contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""
        data = _folder(self.data)

        weak = self.method == "weak"

        def run(store: Path) -> dict[str, Any]:
            run_all = table2_weak.run_table2_weak if weak else table2.run_table2
            return run_all(data, store=store, only=self.only)

        name, table = ("table2-weak", table2_weak.table) if weak else ("table2", table2.table)
        _finish(name, self.out, run, table, whole=not self.only, as_json=self.json)


@dataclass(frozen=True)
class Nulls:
    """Scores of a diagnosis where nothing is missing, on data from a finer grid than the twin's."""

    draws: int = nulls.DRAWS
    """Draws of noise on every specimen."""
    out: Path | None = None
    """JSON file to write; default: runs/bench-nulls/nulls.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose names contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""
        if self.draws < 1:
            raise ValueError(f"--draws {self.draws}: at least one is wanted")

        def run(store: Path) -> dict[str, Any]:
            return nulls.run_nulls(draws=self.draws, store=store, only=self.only)

        whole = not self.only
        _finish("nulls", self.out, run, nulls.table, whole=whole, as_json=self.json)


@dataclass(frozen=True)
class Effects:
    """Every effect, at three sizes, found again in a press and a shake; none where none acts."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-effects/effects.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose names contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""

        def run(store: Path) -> dict[str, Any]:
            return effects.run_effects(store=store, only=self.only)

        whole = not self.only
        _finish("effects", self.out, run, effects.table, whole=whole, as_json=self.json)


@dataclass(frozen=True)
class Blind:
    """Diagnose cases whose truth is sealed; with --score and --key, say what the verdicts are worth."""

    seal: Path
    """File with the SHA-256 of the key."""
    cases: Path | None = None
    """Folder of cases (ID/press.h5, shake.h5 and heldout.h5), or a list of seeds of this project's
    own generator (tests/oracles/hidden_effects_set.py)."""
    out: Path | None = None
    """File of verdicts, which grows by a line for each case; default: runs/bench-blind/blind.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose ids contain one of these."""
    press_alone: bool = False
    """Read the press without the shake; its verdicts want a file of their own."""
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
            told = blind_score.score(self.score, self.key, self.seal)
            emit(blind_score.table(told), told, as_json=self.json)
            return
        if self.cases is None:
            raise ValueError("no --cases: a folder of cases, or a list of seeds")
        out = self.out or Path("runs/bench-blind/blind.json")
        result = blind.run_blind(self.cases, self.seal, out, only=self.only, alone=self.press_alone)
        emit(blind.table(result), result, as_json=self.json)
        say(f"written: {out}")


@dataclass(frozen=True)
class Positions:
    """Positions only: six wrong starts, then sparse and noisy with coverage of the intervals."""

    data: Path | None = None
    """Folder of the shared NCLaw data; default: the environment variable FORM_DRAKE_NCLAW."""
    out: Path | None = None
    """JSON file to write; default: runs/bench-positions/positions.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose names contain one of these."""
    seeds: int = positions.SEEDS
    """Noise seeds."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""
        data = _folder(self.data)

        def run(store: Path) -> dict[str, Any]:
            return positions.run_positions(data, store=store, only=self.only, seeds=self.seeds)

        _finish("positions", self.out, run, positions.table, whole=not self.only, as_json=self.json)


@dataclass(frozen=True)
class Speed:
    """Particle-steps per second beside a textbook code and Taichi (optional), in one run."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-speed/speed.json."""
    only: tuple[str, ...] = ()
    """Run only these cases."""
    particles: int = speed.PARTICLES
    """Particles of the block, the cube of an even number."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""

        def run(_: Path) -> dict[str, Any]:
            with tqdm(unit="window", disable=None, delay=2, leave=False) as bar:

                def progress(done: int, total: int) -> None:
                    bar.total = total
                    bar.update(done - bar.n)

                return speed.run_speed(
                    only=self.only or None,
                    particles=self.particles,
                    device=self.device,
                    progress=progress,
                )

        _finish("speed", self.out, run, speed.table, whole=not self.only, as_json=self.json)


@dataclass(frozen=True)
class Rubber:
    """Measured curves of rubber and tissue: laws fitted to some modes predict the others."""

    data: Path
    """Folder of tables (.csv) with columns mode, stretch, nominal_stress_Pa."""
    laws: Path | None = None
    """Python file with laws of your own, fitted alone and beside yeoh; it is executed."""
    recordings: Path | None = None
    """Folder: write every curve there as a recording for form-drake identify, and do no fit."""
    out: Path | None = None
    """JSON file to write; default: runs/bench-rubber/rubber.json."""
    only: tuple[str, ...] = ()
    """Run only fits whose names (table/law/all or table/law/without-MODE) contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench, or write the recordings."""
        if not self.data.is_dir():
            raise ValueError(f"{self.data}: no such folder")
        if self.recordings is not None:
            self._write(self.recordings)
            return

        def run(store: Path) -> dict[str, Any]:
            return rubber.run_rubber(self.data, store=store, own=self.laws, only=self.only)

        _finish("rubber", self.out, run, rubber.table, whole=not self.only, as_json=self.json)

    def _write(self, folder: Path) -> None:
        written = []
        for path in rubber.tables(self.data):
            for mode, recording in recordings(path).items():
                place = target(folder / f"{path.stem}-{mode}.h5")
                write_recording(recording, place)
                written.append(str(place))
        emit("\n".join(written), {"recordings": written}, as_json=self.json)


@dataclass(frozen=True)
class WeakForm:
    """The weak form on exact motions and finite elements of tests/oracles; needs a checkout."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-weak-form/weak-form.json."""
    only: tuple[str, ...] = ()
    """Run only cases whose names (such as exact/yeoh or fe/press-a) contain one of these."""
    seeds: int = weak_form.SEEDS
    """Noise seeds."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""

        def run(store: Path) -> dict[str, Any]:
            return weak_form.run_weak_form(store=store, only=self.only, seeds=self.seeds)

        _finish("weak-form", self.out, run, weak_form.table, whole=not self.only, as_json=self.json)


@dataclass(frozen=True)
class Probes:
    """Probes in the station against the truth, on three grids too, and those of finite elements."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-probes/probes.json. Simulated motions stay beside it."""
    only: tuple[str, ...] = ()
    """Run only cases whose names (such as exact/press_a, noise/bend-3, own-stress/press-3, dx/bend_a
    or fe/press-b) contain one of these."""
    seeds: int = probes.SEEDS
    """Noise seeds."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""

        def run(store: Path) -> dict[str, Any]:
            return probes.run_probes(store=store, only=self.only, seeds=self.seeds)

        _finish("probes", self.out, run, probes.table, whole=not self.only, as_json=self.json)


@dataclass(frozen=True)
class Perception:
    """Probes seen by two cameras: pictures, tracks, inside, law, and what disturbs them."""

    out: Path | None = None
    """JSON file to write; default: runs/bench-perception/perception.json. Motions and tracks stay
    beside it."""
    only: tuple[str, ...] = ()
    """Run only cases whose names (such as stereo/press_a, stereo/bend-3, fe/press-a, paper/bend_b or
    sweep/noise/5/press_a) contain one of these."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench."""

        def run(store: Path) -> dict[str, Any]:
            return perception.run_perception(store=store, only=self.only)

        _finish(
            "perception", self.out, run, perception.table, whole=not self.only, as_json=self.json
        )


@dataclass(frozen=True)
class Deformable:
    """Drake's own deformable bodies on three meshes, stored with the tests; needs a checkout."""

    recordings: Path | None = None
    """Folder: write every motion there as a recording for form-drake identify, and identify none."""
    out: Path | None = None
    """JSON file to write; default: runs/bench-deformable/deformable.json."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Run the bench, or write the recordings."""
        if self.recordings is None:
            run = deformable.run_deformable
            table = deformable.table
            _finish("deformable", self.out, run, table, whole=True, as_json=self.json)
            return
        written = []
        for name in deformable.NAMES:
            place = target(self.recordings / f"{name}.h5")
            write_recording(deformable.recording(name), place)
            written.append(str(place))
        emit("\n".join(written), {"recordings": written}, as_json=self.json)


@dataclass(frozen=True)
class Bench:
    """Measure what the documents state; long benches resume where they were interrupted."""

    case: tyro.conf.OmitSubcommandPrefixes[
        Annotated[Table2, tyro.conf.subcommand("table2")]
        | Annotated[Nulls, tyro.conf.subcommand("nulls")]
        | Annotated[Effects, tyro.conf.subcommand("effects")]
        | Annotated[Blind, tyro.conf.subcommand("blind")]
        | Annotated[Positions, tyro.conf.subcommand("positions")]
        | Annotated[Speed, tyro.conf.subcommand("speed")]
        | Annotated[Rubber, tyro.conf.subcommand("rubber")]
        | Annotated[WeakForm, tyro.conf.subcommand("weak-form")]
        | Annotated[Probes, tyro.conf.subcommand("probes")]
        | Annotated[Perception, tyro.conf.subcommand("perception")]
        | Annotated[Deformable, tyro.conf.subcommand("deformable")]
    ]

    def run(self) -> None:
        """Run the chosen bench."""
        self.case.run()
