"""A simulation of particles on a lattice."""

import numpy as np
import pytest

from form_drake.laws import LAWS
from form_drake.mpm.simulation import Body, Simulation

DEVICES = ("cpu", pytest.param("cuda:0", marks=pytest.mark.gpu))
SOFT = {"C10": 2e3, "kappa": 2e4}
DENSITY = 1000.0


def lattice(counts, h):
    """Cell centres of a box of cubes with edge h [m], the box's corner at the origin."""
    return (np.indices(counts).reshape(3, -1).T + 0.5) * h


def simulation(solver, law, values, x, volume, *, density=DENSITY, device="cpu"):
    made = Simulation(solver, LAWS[law], Body(x, np.full(len(x), volume), density), device=device)
    made.set_material(values)
    made.reset(x, np.zeros_like(x))
    return made
