"""Whether forces are those of the material on the tool, or have the other sign."""

from dataclasses import replace

import numpy as np

from form_drake.identify.options import Weighed
from form_drake.identify.problem import Problem
from form_drake.identify.weighing import weighing
from form_drake.weak.unknowns import Unknowns

FIRMER = 1.25  # times the shear modulus, that forces of the right sign give at least


def terms_of(unknowns: Unknowns, reduced: np.ndarray) -> dict[str, float]:
    """Coefficients of a law's terms by key."""
    theta = unknowns.theta(reduced)
    return {t.key: float(v) for t, v in zip(unknowns.law.terms, theta, strict=True)}


def require_sign(found: Weighed) -> None:
    """Refuse forces under which a body is softer than with the other sign.

    Beside rows of the interior, which hold for no stiffness at all, those of forces of the other sign pull
    moduli down to their floors, or as near as other errors let them.

    Raises:
        ValueError: they are such.
    """
    if not any(p.forces for p in found.problem.probes):
        return
    here, there = (_firmness(one) for one in (found, weighing(_turned(found.problem))))
    if there > FIRMER * here:
        raise ValueError(
            "forces would be those of a body with the other sign: they are those of the material on the"
            " tool; is their sign turned, or their zero far off?"
        )


def _turned(problem: Problem) -> Problem:
    """With forces of the other sign."""
    probes = [
        replace(p, forces={k: replace(f, value=-f.value) for k, f in p.forces.items()})
        for p in problem.probes
    ]
    return replace(problem, probes=tuple(probes), offset=None)


def _firmness(found: Weighed) -> float:
    """Shear modulus [Pa], or bulk modulus of what has none; zero: it does not stand above the floors."""
    problem, theta = found.problem, found.solution.theta
    unknowns = problem.unknowns
    system = problem.system(found.eta, unknowns.theta(theta))
    floors = problem.floors(system)
    positive = np.isfinite(floors)
    if positive.any() and not np.any(theta[positive] > 2.0 * floors[positive]):
        return 0.0
    K, G = unknowns.law.moduli(problem.values(found.eta) | terms_of(unknowns, theta))
    return float(G or K)
