"""Speed of the solver beside a textbook code and Taichi, on one job and in one run.

The cases take turns in short windows, every window from the same start, so that a machine that is
busy or changes its clock meets all of them alike; what counts are ratios within one round.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median

import numpy as np
import warp as wp

from form_drake.bench.taichi_peer import NO_TAICHI, Taichi, taichi_available
from form_drake.bench.textbook import Job, Textbook
from form_drake.laws import law_named
from form_drake.laws.values import lame
from form_drake.mpm.simulation import Body, Simulation
from form_drake.records.solver import Solver

PARTICLES = 21952
ROUNDS = 9
STEPS = {"cpu": 40, "cuda": 400}
PADDING, SWEPT = 18, 10  # cells beside a block; those beside what it sweeps as it turns
YOUNG, POISSON, DENSITY, TAU_Y = 8.0e4, 0.45, 1000.0, 2.0e3
DX, DT = 2.0e-3, 4.0e-5


@dataclass(frozen=True)
class Case:
    """One row: the solver's gradient, law, precision and grid, or a peer's name and law."""

    label: str
    law: str
    gradient: str | None = None
    precision: str = "float32"
    total: bool = False
    peer: str | None = None


CASES: dict[str, Case] = {
    "mls": Case("MLS gradient, fixed-corotated", "fixed-corotated", "mls"),
    "exact": Case("exact gradient, fixed-corotated", "fixed-corotated", "exact"),
    "exact-von-mises": Case("exact gradient, von Mises (J2)", "von-mises", "exact"),
    "exact-neo-hookean": Case("exact gradient, neo-Hookean", "neo-hookean", "exact"),
    "exact-float64": Case(
        "exact gradient, fixed-corotated, float64", "fixed-corotated", "exact", "float64"
    ),
    "rest": Case("MLS over the rest shape, fixed-corotated", "fixed-corotated", "mls", total=True),
    "rest-neo-hookean": Case(
        "MLS over the rest shape, neo-Hookean", "neo-hookean", "mls", total=True
    ),
    "textbook": Case("textbook kernel, fixed-corotated", "fixed-corotated", peer="textbook"),
    "textbook-von-mises": Case("textbook kernel, von Mises (J2)", "von-mises", peer="textbook"),
    "taichi": Case("Taichi, fixed-corotated", "fixed-corotated", peer="taichi"),
}
# numerator, denominator, least ratio; None: stated only
TARGETS: tuple[tuple[str, str, float | None], ...] = (
    ("mls", "textbook", 4.0),
    ("mls", "taichi", 5.0),
    ("exact", "textbook", 2.8),
    ("exact-von-mises", "textbook-von-mises", None),
    ("exact-neo-hookean", "textbook", None),
    ("exact-float64", "exact", None),
    ("rest", "textbook", None),
    ("rest-neo-hookean", "textbook", None),
)
TWO_THREADS = 1.6


def job(particles: int = PARTICLES) -> Job:
    """A block with 8 particles a cell, stretched, turned, drifting and spinning.

    Raises:
        ValueError: ``particles`` is not the cube of an even number.
    """
    side = round(particles ** (1.0 / 3.0))
    if side**3 != particles or side % 2 or side < 2:
        raise ValueError(f"{particles} particles: the block needs the cube of an even number")
    nodes, h = max(side // 2 + PADDING, 3 * side // 4 + SWEPT), DX / 2.0
    axis = (np.arange(side) - 0.5 * (side - 1)) * h
    X = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1.0]])
    F = turn @ np.diag([1.06, 0.97, 0.98])
    x = X @ F.T
    v = np.array([0.3, 0.2, -0.1]) + np.cross([0.0, 5.0, 10.0], x)
    mu, lam = lame(YOUNG, POISSON)
    x = x + 0.5 * (nodes - 1) * DX
    shapes = np.tile(F, (particles, 1, 1))
    return Job(x, v, shapes, h**3, DENSITY, nodes, DX, DT, mu, lam, TAU_Y)


class Own:
    """The package's solver on the job, with the interface of the peers."""

    def __init__(self, job: Job, case: Case, *, device: str = "cpu"):
        how = {"gradient": case.gradient, "precision": case.precision, "gravity": (0.0, 0.0, 0.0)}
        solver = Solver(dx=job.dx, nodes=(job.nodes,) * 3, dt=job.dt, **how)
        values = {"mu": job.mu, "lam": job.lam, "tau_y": job.tau_y}
        values |= {"C10": job.mu / 2.0, "kappa": job.lam + 2.0 / 3.0 * job.mu}
        law = law_named(case.law)
        middle = job.x.mean(axis=0)
        rest = np.linalg.solve(job.F, (job.x - middle)[..., None])[..., 0] + middle
        body = Body(rest if case.total else job.x, np.full(len(job.x), job.volume), job.density)
        self._job = job
        self._simulation = Simulation(solver, law, body, total=case.total, device=device)
        self._simulation.set_material({key: values[key] for key in law.keys})
        self.step = self._simulation.step

    def reset(self) -> None:
        """Back to the start of the job."""
        self._simulation.reset(self._job.x, self._job.v, F=self._job.F, T=self._job.F)

    @property
    def x(self) -> np.ndarray:
        """Positions [m], shape [particles, 3]."""
        return self._simulation.x


def _runner(case: Case, job: Job, device: str):
    if case.peer == "textbook":
        return Textbook(job, case.law, device=device)
    if case.peer == "taichi":
        return Taichi(job, device=device)
    return Own(job, case, device=device)


def _window(runner, steps: int, device: str) -> tuple[float, float]:
    """Wall time [s] and process CPU time [s] of some steps from the start of the job."""
    runner.reset()
    wp.synchronize_device(device)
    wall, cpu = time.perf_counter(), time.process_time()
    runner.step(steps)
    wp.synchronize_device(device)
    return time.perf_counter() - wall, time.process_time() - cpu


def _together(runners, steps: int) -> tuple[float, float]:
    """Wall time [s] of the steps with one thread per runner, and the slowest's CPU time [s]."""
    cpu = [0.0] * len(runners)

    def work(i: int) -> None:
        start = time.thread_time()
        runners[i].step(steps)
        cpu[i] = time.thread_time() - start

    for runner in runners:
        runner.reset()
    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(runners))]
    start = time.perf_counter()
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return time.perf_counter() - start, max(cpu)


def _chosen(only: tuple[str, ...] | None) -> tuple[list[str], dict[str, str]]:
    """Keys of the cases to run, and the reason for every skipped one."""
    for part in only or ():
        if not any(part in key for key in CASES):
            raise ValueError(f"unknown case {part!r}: choose from {', '.join(CASES)}")
    keys = [key for key in CASES if not only or any(part in key for part in only)]
    if "taichi" in keys and not taichi_available():
        return [key for key in keys if key != "taichi"], {"taichi": NO_TAICHI}
    return keys, {}


def run_speed(
    *,
    only: tuple[str, ...] | None = None,
    particles: int = PARTICLES,
    rounds: int = ROUNDS,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> dict:
    """Million particle-steps per second of every case.

    On the CPU a window counts by its CPU time, on a CUDA device by wall time.

    Args:
        only: parts of the keys of ``CASES``; None or empty: all.
        particles: of the block, the cube of an even number.
        rounds: how often every case takes its turn.
        device: ``cpu`` or a CUDA device.
        progress: called with the parts done and their number.

    Returns:
        rows, ratios, targets, the skipped cases, and the two-thread speed-up (CPU only).
    """
    keys, skipped = _chosen(only)
    block, on_cpu = job(particles), device == "cpu"
    steps, total = (
        STEPS["cpu" if on_cpu else "cuda"],
        len(keys) + rounds + (rounds if on_cpu else 0),
    )
    tell = progress or (lambda done, of: None)
    runners = {}
    for key in keys:
        runners[key] = _runner(CASES[key], block, device)
        _window(runners[key], 2, device)
        tell(len(runners), total)
    windows: dict[str, list[tuple[float, float]]] = {key: [] for key in keys}
    for i in range(rounds):
        for key in keys if i % 2 == 0 else reversed(keys):
            windows[key].append(_window(runners[key], steps, device))
        tell(len(keys) + i + 1, total)
    threads = {}
    if on_cpu:
        threads = _two_threads(block, rounds, steps, lambda i: tell(len(keys) + rounds + i, total))
    work = particles * steps / 1e6
    report = {
        "device": wp.get_device(device).name,
        "clock": "CPU time" if on_cpu else "wall time",
        "job": {"particles": particles, "nodes": block.nodes, "dx": DX, "dt": DT},
        "rounds": rounds,
        "differences": _differences(runners),
        "skipped": skipped,
        **threads,
    }
    return report | _evaluated(windows, work, int(on_cpu), threads)


def _differences(runners: dict) -> dict[str, float]:
    """Largest distance [m] between the ends of the same job in two codes."""
    pairs = (("mls", "textbook"), ("mls", "taichi"))
    return {
        f"{a}/{b}": float(np.max(np.linalg.norm(runners[a].x - runners[b].x, axis=1)))
        for a, b in pairs
        if a in runners and b in runners
    }


def _two_threads(block: Job, rounds: int, steps: int, tell: Callable[[int], None]) -> dict:
    """Speed-up of two simulations in two threads over one after the other.

    ``cpu`` compares CPU times: the bound that memory and clock set where two cores are free.
    """
    pair = [Own(block, CASES["exact"]) for _ in range(2)]
    wall, free = [], []
    for i in range(rounds):
        one, one_cpu = _together(pair[:1], steps)
        two, two_cpu = _together(pair, steps)
        wall.append(2.0 * one / two)
        free.append(2.0 * one_cpu / two_cpu)
        tell(i + 1)
    return {"two_threads": {"wall": median(wall), "best_wall": max(wall), "cpu": median(free)}}


def _evaluated(windows: dict, work: float, clock: int, threads: dict) -> dict:
    """Rows, ratios and targets from the windows' times; ``work`` in million particle-steps."""

    def ratio(a: str, b: str) -> float | None:
        if a not in windows or b not in windows:
            return None
        pairs = zip(windows[a], windows[b], strict=True)
        return median(theirs[clock] / mine[clock] for mine, theirs in pairs)

    rows = [
        {
            "case": key,
            "label": CASES[key].label,
            "mpps": work / median(t[clock] for t in times),
            "mpps_best": work / min(t[clock] for t in times),
            "mpps_wall": work / median(t[0] for t in times),
            "ratio_to_textbook": ratio(key, "textbook"),
        }
        for key, times in windows.items()
    ]
    targets = [
        {"ratio": f"{a}/{b}", "value": ratio(a, b), "at_least": least} for a, b, least in TARGETS
    ]
    if threads:
        value = threads["two_threads"]["wall"]
        targets.append({"ratio": "two threads/one", "value": value, "at_least": TWO_THREADS})
    for target in targets:
        value, least = target["value"], target["at_least"]
        target["met"] = None if value is None or least is None else value >= least
    ratios = {target["ratio"]: target["value"] for target in targets}
    return {"rows": rows, "ratios": ratios, "targets": targets}


def table(result: dict) -> str:
    """The result of ``run_speed`` as lines of text."""
    of, lines = result["job"], []
    lines.append(
        f"{of['particles']} particles, 8 a cell, grid {of['nodes']}^3, {result['device']}, "
        f"{result['clock']}; million particle-steps per second, median of {result['rounds']}"
    )
    lines.append(f"{'case':<42}{'Mp/s':>8}{'best':>8}{'wall':>8}{'x textbook':>12}")
    for row in result["rows"]:
        times = "-" if row["ratio_to_textbook"] is None else f"{row['ratio_to_textbook']:.2f}"
        speeds = "".join(f"{row[k]:>8.2f}" for k in ("mpps", "mpps_best", "mpps_wall"))
        lines.append(f"{row['label']:<42}{speeds}{times:>12}")
    lines += result["skipped"].values()
    for target in result["targets"]:
        if target["value"] is None:
            continue
        goals = result["clock"] == "CPU time"  # they are of one core
        stated = target["at_least"] is None or not goals
        goal = "stated" if stated else f"at least {target['at_least']:g}"
        mark = "" if stated else {True: ", met", False: ", MISSED"}[target["met"]]
        lines.append(f"{target['ratio']}: {target['value']:.2f} ({goal}{mark})")
    if "two_threads" in result:
        lines.append(f"two threads/one by CPU time: {result['two_threads']['cpu']:.2f}")
    for pair, distance in result["differences"].items():
        lines.append(f"{pair}: same motion to {distance:.1e} m")
    return "\n".join(lines)
