"""What noise does to the rows of a balance, and what simulations of held layers have wrong."""

from collections.abc import Callable, Sequence

import numpy as np

from form_drake.diagnose.between import between
from form_drake.diagnose.model import Model, Scenes
from form_drake.diagnose.plates import Elsewhere, plate_errors, simulated
from form_drake.identify.problem import Problem, Rows
from form_drake.weak.contact import STIFFNESS, HeldFields, held
from form_drake.weak.probe import Probe
from form_drake.weak.solve import Weights, weights
from form_drake.weak.system import Row

Draws = Sequence[tuple[Rows, Rows]]

PAIRS = 4  # of draws
SURE = 4.0  # standard deviations
LAYER = 0.05  # of the grid spacing times the strain, that a held layer is wrong by
ALONE = 0.3  # of that, from one window to the next


def most(chance: float) -> float:
    """What noise may leave of the square of whitened rows, more than which is no chance.

    ``SURE`` standard deviations of a chi-square of as many rows as it leaves on average, and of that
    average over draws.
    """
    return chance + SURE * float(np.sqrt(2.0 * chance * (1.0 + 1.0 / PAIRS)))


def shaken(data: Problem, twin: Problem, eta: np.ndarray, theta: np.ndarray) -> Draws:
    """What draws of the noise of data change of the rows A and b of a twin, and their opposites.

    At all of its points: at fewer, noise enters the rows by up to half as much again. Draws that would fold a
    body are left out.
    """
    rng, (A, b), found = np.random.default_rng(0), twin.rows(eta, theta), []
    for _ in range(PAIRS):
        changes = twin.changes([probe.drawn(rng) for probe in data.probes])
        one, other = (twin.disturbed(eta, changes, sign) for sign in (1.0, -1.0))
        if one is not None and other is not None:
            found.append(((one[0] - A, one[1] - b), (other[0] - A, other[1] - b)))
    return found


def layer_error(probe: Probe, dx: float) -> np.ndarray:
    """Covariance of what a simulation has wrong of the layers at held faces, of all rows.

    Seen in blocks of finite elements without any effect: it grows with the strain at the face, and
    stays alike while that does.
    """
    total = np.zeros((len(probe.keep),) * 2)
    points = sum(len(f.points) for f in probe.fields if isinstance(f, HeldFields))
    if points:
        strain = probe.motion.F[:, -points:] - np.eye(3)
        size = np.sqrt(np.mean(np.sum(strain**2, axis=(2, 3)), axis=1))
        error = LAYER * dx * STIFFNESS * (probe.windows.chi @ size)
        rows = np.flatnonzero(held(probe.fields, probe.windows)).reshape(len(error), -1)
        for own in rows.T:
            total[np.ix_(own, own)] = np.outer(error, error) + ALONE**2 * np.diag(error**2)
    return total[np.ix_(probe.keep, probe.keep)]


def by_field(problem: Problem, error: np.ndarray) -> np.ndarray:
    """An error of all rows as one of every test field, shape [rows, fields of all probes].

    What a grid has wrong keeps its course in time and differs from place to place: of two grids one
    tells how large it is there, not how much of it is left.
    """
    return _parted(problem, error, lambda row: row.field)


def by_window(problem: Problem, error: np.ndarray) -> np.ndarray:
    """The same of every window, shape [rows, windows of all probes]."""
    return _parted(problem, error, lambda row: row.window)


def _parted(problem: Problem, error: np.ndarray, of: Callable[[Row], object]) -> np.ndarray:
    labels = [(n, of(row)) for n, p in enumerate(problem.probes) for row in p.labels]
    own = {label: n for n, label in enumerate(dict.fromkeys(labels))}
    found = np.zeros((len(error), len(own)))
    found[np.arange(len(error)), [own[label] for label in labels]] = error
    return found


def weighed(
    problem: Problem,
    twin: Problem,
    scenes: Scenes,
    model: Model,
    made: Sequence[Elsewhere] | None = None,
) -> Weights:
    """Inverse covariance of noise, and of what simulations have wrong at held faces.

    What frames miss of a motion is one more error of the rows of every window; where plates may stand
    elsewhere than they are told to, that is one more of all rows.

    Args:
        problem: probes of the data.
        twin: the same of the simulation.
        scenes: of all of them.
        model: of the simulation.
        made: simulated with plates elsewhere; None: that is done here.

    Raises:
        ValueError: such a simulation fails, or cannot be read.
    """
    noise = problem.noise(*problem.coordinates(model.values))
    pairs = zip(noise, twin.probes, scenes.dx, strict=True)
    noise = [n + layer_error(p, dx) for n, p, dx in pairs]
    found = weights(noise, np.ones(sum(map(len, noise))), 0.0)
    for missed in between(problem, twin, scenes, model).T:
        found = found.beside(by_window(problem, missed))
    made = simulated(scenes, model) if made is None else made
    return found.beside(plate_errors(problem, twin, scenes, model, made)) if made else found
