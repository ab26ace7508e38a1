"""``form-drake track``: from pictures of two cameras to a recording of a face's points."""

import time
from dataclasses import dataclass
from pathlib import Path

import tyro
from tqdm import tqdm

from form_drake.commands.output import device, emit, out_file, say
from form_drake.files import spare
from form_drake.records import read, write_recording

GAPS = 5  # that are told one by one


@dataclass(frozen=True)
class Track:
    """Track points of a specimen's face through the pictures of two cameras."""

    images: tyro.conf.Positional[tuple[Path, ...]]
    """One folder of pictures or more, or pictures, named CAMERA_NUMBER.png with the cameras' names."""
    calibration: Path
    """Rig (YAML): cameras, their rate, the specimen's box and the face that is seen."""
    out: Path
    """Recording to write (.h5)."""
    probe: Path | None = None
    """Recording of what was measured beside the pictures (poses, forces, law, contact); frame 0 is at
    its first stamp."""
    report: Path | None = None
    """Page to write (.html): pictures with the points on them, and what is wrong with each."""
    device: str = "cpu"
    """Warp device: cpu or cuda:0."""
    json: bool = False
    """Print one JSON object instead of a table."""

    def run(self) -> None:
        """Track, complete with what the probe measured, and write the recording."""
        from form_drake.perceive.pictures import Pictures
        from form_drake.perceive.rig import Rig
        from form_drake.perceive.seen import APART, Count, Sight, completed, tracked
        from form_drake.seen_report import write_seen_report

        device(self.device)
        out = out_file(self.out, ".h5", ".hdf5")
        spare(out, self.calibration, self.probe, *self.images)
        page = None if self.report is None else out_file(self.report, ".html", option="--report")
        rig = Rig.read(self.calibration)
        beside = None if self.probe is None else read(self.probe)
        pictures = Pictures.found(self.images, rig.cameras)
        _tell(pictures.left_out)
        if beside is not None and pictures.frames[0]:
            late = pictures.frames[0] / rig.rate
            say(
                f"the first picture is frame {pictures.frames[0]}: {late:.4g} s after the first stamp of {self.probe}"
            )
        begin = 0.0 if beside is None else float(beside.time[0])
        with tqdm(
            total=len(pictures.frames), unit="frame", disable=None, delay=2, leave=False
        ) as bar:
            sights: list[Sight] = []

            def seen(_: int, sight: Sight) -> None:
                sights.append(sight)
                bar.update()

            started = time.perf_counter()
            found = tracked(rig, pictures, begin, self.device, seen)
            seconds = (time.perf_counter() - started) / len(pictures.frames)
        count = Count.of(rig, sights)
        both = zip(pictures.frames, sights, strict=True)
        apart = {n: sight.apart for n, sight in both if sight.apart > APART}
        _tell({n: "the cameras show other times, or one was moved" for n in apart})
        made = found if beside is None else completed(found, beside)
        write_recording(made, out)
        if page is not None:
            write_seen_report(page, rig, pictures, sights)
            say(f"report: {page}")
        result = {
            "recording": str(out),
            "frames": made.frames,
            "points": made.points,
            "asked": count.asked,
            "found_first": count.first,
            "held": count.held,
            "seconds_a_frame": seconds,
            "missing_frames": {str(n): list(c) for n, c in pictures.missing.items()},
            "unusable_frames": {str(n): why for n, why in pictures.unusable.items()},
            "apart_frames": {str(n): size for n, size in apart.items()},
            "noise": made.noise,
        }
        text = (
            f"{made.frames} frames of {made.points} points on face {rig.face.name}: {count},"
            f" {1e6 * (made.noise or 0.0):.2g} um of noise in a coordinate, {seconds:.2g} s a frame"
        )
        emit(text, result, as_json=self.json)
        say(f"written: {out}")


def _tell(left_out: dict[int, str]) -> None:
    """Say which frames are left out, and why."""
    for frame, why in list(left_out.items())[:GAPS]:
        say(f"frame {frame}: {why}, left out")
    if len(left_out) > GAPS:
        say(f"{len(left_out) - GAPS} more frames are left out, to the last, {max(left_out)}")
