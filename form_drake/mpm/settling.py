"""How a body among still tools comes to rest."""

from dataclasses import replace

import numpy as np

from form_drake.mpm.exchange import Scene, Snapshot
from form_drake.mpm.tools import Motions

LONGEST = 5.0  # time [s] in which a body must come to rest
STRIDE = 2e-3  # of it [s], between looks at how fast the body is
LEFT, LEAST = 1e-3, 1e-5  # of how far the body has come, and of its size, that may be left to move


def rested(scene: Scene, snapshot: Snapshot, still: Motions) -> Snapshot:
    """A body that stays where it is: the same one where that is so, else after it has gone there.

    Let go of without viscosity, which would let it creep, a body swings through its rest and is halted
    where it is fastest, until it hardly moves on the way there (kinetic damping, Barnes 1999). What only
    slides as a whole, as between smooth faces, has its shape at rest.

    Args:
        scene: of a solid.
        snapshot: when its tools have stopped.
        still: where they are.

    Raises:
        ValueError: it does not come to rest.
    """
    gone = np.abs(snapshot.p_WQ - scene.rest).max()
    enough = max(LEFT * float(gone), LEAST * float(np.ptp(scene.rest, axis=0).max()))
    mass = scene.simulation.body.mass[:, None] / scene.simulation.body.mass.sum()
    begin = now = _halted(snapshot)
    fastest = 0.0
    scene.resist_rates(False)
    for _ in range(round(LONGEST / STRIDE)):
        after = scene.advance(now, still, STRIDE, -scene.drag)
        v = after.state.v - np.sum(mass * after.state.v, axis=0)
        energy = float(np.sum(mass * v**2))
        if energy > fastest:
            now, fastest = after, energy
            continue
        moved = now.p_WQ - begin.p_WQ
        if np.abs(moved - np.sum(mass * moved, axis=0)).max() <= enough:
            scene.resist_rates(True)
            return snapshot
        snapshot = begin = now = _halted(now)
        fastest = 0.0
    raise ValueError(
        f"the body does not come to rest in {LONGEST:g} s before the first frame: it is"
        " too soft or heavy for its size; check its faces, moduli, density, mass_scale and units"
    )


def _halted(snapshot: Snapshot) -> Snapshot:
    rates = ("v", "C", "L", "grid", "late", "felt")
    none = {k: np.zeros_like(getattr(snapshot.state, k)) for k in rates}
    return replace(snapshot, state=replace(snapshot.state, **none))
