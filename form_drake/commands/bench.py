"""``form-drake bench``: the tables that the documents hold, one command each."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from tqdm import tqdm

from form_drake.bench import (
    deformable,
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
from form_drake.commands.bench_cases import Cases
from form_drake.commands.bench_diagnosis import Blind, Effects, Nulls, Station
from form_drake.commands.output import device, emit
from form_drake.files import target
from form_drake.records import Recording, write_recording

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


def _written(made: Mapping[str, Recording], folder: Path, *, as_json: bool) -> None:
    """Write recordings into a folder, under their names."""
    written = []
    for name, recording in made.items():
        place = target(folder / f"{name}.h5")
        write_recording(recording, place)
        written.append(str(place))
    emit("\n".join(written), {"recordings": written}, as_json=as_json)


@dataclass(frozen=True, kw_only=True)
class Table2(Cases):
    """The paper's Table II on the shared NCLaw data, with the floors of this solver."""

    data: Path | None = None
    """Folder of the shared NCLaw data; default: the environment variable FORM_DRAKE_NCLAW."""
    method: Literal["step", "weak"] = "step"
    """step: the table; weak: the bias of the weak form on the same data, with the twin offset."""

    def run(self) -> None:
        """Run the bench."""
        data = _folder(self.data)
        if self.method == "weak":
            run = partial(table2_weak.run_table2_weak, data)
            self.finish("table2-weak", run, table2_weak.table)
        else:
            self.finish("table2", partial(table2.run_table2, data), table2.table)


@dataclass(frozen=True, kw_only=True)
class Positions(Cases):
    """Positions only: six wrong starts, then sparse and noisy with coverage of the intervals."""

    data: Path | None = None
    """Folder of the shared NCLaw data; default: the environment variable FORM_DRAKE_NCLAW."""
    seeds: int = positions.SEEDS
    """Noise seeds."""

    def run(self) -> None:
        """Run the bench."""
        run = partial(positions.run_positions, _folder(self.data), seeds=self.seeds)
        self.finish("positions", run, positions.table)


@dataclass(frozen=True, kw_only=True)
class Speed(Cases):
    """Particle-steps per second beside a textbook code and Taichi (optional), in one run."""

    particles: int = speed.PARTICLES
    """Particles of the block, the cube of an even number."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""

    def run(self) -> None:
        """Run the bench."""
        device(self.device)

        def run(store: Path, only: tuple[str, ...]) -> dict[str, Any]:
            with tqdm(unit="window", disable=None, delay=2, leave=False) as bar:

                def progress(done: int, total: int) -> None:
                    bar.total = total
                    bar.update(done - bar.n)

                return speed.run_speed(
                    only=only,
                    particles=self.particles,
                    device=self.device,
                    progress=progress,
                )

        self.finish("speed", run, speed.table)


@dataclass(frozen=True, kw_only=True)
class Rubber(Cases):
    """Measured curves of rubber and tissue: laws fitted to some modes predict the others."""

    data: Path
    """Folder of tables (.csv) with columns mode, stretch, nominal_stress_Pa."""
    laws: Path | None = None
    """Python file with laws of your own, fitted alone and beside yeoh; it is executed."""
    recordings: Path | None = None
    """Folder: write every curve there as a recording for form-drake identify, and do no fit."""

    def run(self) -> None:
        """Run the bench, or write the recordings."""
        if not self.data.is_dir():
            raise ValueError(f"{self.data}: no such folder")
        if self.recordings is not None:
            probes = {
                f"{path.stem}-{mode}": recording
                for path in rubber.tables(self.data)
                for mode, recording in recordings(path).items()
            }
            _written(probes, self.recordings, as_json=self.json)
            return
        run = partial(rubber.run_rubber, self.data, own=self.laws)
        self.finish("rubber", run, rubber.table)


@dataclass(frozen=True, kw_only=True)
class WeakForm(Cases):
    """The weak form on exact motions and finite elements of tests/oracles; needs a checkout.

    Cases are called exact/yeoh, refused/gent, fe/press-a, noise/yeoh/1/seeds20 and so on.
    """

    seeds: int = weak_form.SEEDS
    """Noise seeds."""

    def run(self) -> None:
        """Run the bench."""
        self.finish(
            "weak-form", partial(weak_form.run_weak_form, seeds=self.seeds), weak_form.table
        )


@dataclass(frozen=True, kw_only=True)
class Probes(Cases):
    """Probes in the station against the truth, on three grids too, and those of finite elements.

    Cases are called exact/press_a, noise/bend-3, own-stress/press-3, rate/bend_a, dx/bend_a, fe/press-b
    and so on. Simulated motions stay beside the result.
    """

    seeds: int = probes.SEEDS
    """Noise seeds."""

    def run(self) -> None:
        """Run the bench."""
        self.finish("probes", partial(probes.run_probes, seeds=self.seeds), probes.table)


@dataclass(frozen=True, kw_only=True)
class Perception(Cases):
    """Probes seen by two cameras: pictures, tracks, inside, law, and what disturbs them.

    Cases are called stereo/press_a, stereo/bend-3, fe/press-a, paper/bend_b, sweep/noise/5/press_a and
    so on. Motions and tracks stay beside the result.
    """

    def run(self) -> None:
        """Run the bench."""
        self.finish("perception", perception.run_perception, perception.table)


@dataclass(frozen=True, kw_only=True)
class Deformable(Cases):
    """Drake's own deformable bodies on three meshes, stored with the tests; needs a checkout."""

    recordings: Path | None = None
    """Folder: write every motion there as a recording for form-drake identify, and identify none."""

    def run(self) -> None:
        """Run the bench, or write the recordings."""
        if self.recordings is None:
            self.finish("deformable", deformable.run_deformable, deformable.table)
        else:
            made = {name: deformable.recording(name) for name in deformable.NAMES}
            _written(made, self.recordings, as_json=self.json)


@dataclass(frozen=True)
class Bench:
    """Measure what the documents state; long benches resume where they were interrupted."""

    case: tyro.conf.OmitSubcommandPrefixes[
        Annotated[Table2, tyro.conf.subcommand("table2")]
        | Annotated[Nulls, tyro.conf.subcommand("nulls")]
        | Annotated[Effects, tyro.conf.subcommand("effects")]
        | Annotated[Station, tyro.conf.subcommand("station")]
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
