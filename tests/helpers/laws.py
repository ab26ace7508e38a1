"""Stored steps of the oracle, and the stress of a law after the kernel that ends a step."""

import json
from functools import cache
from pathlib import Path

import numpy as np
import warp as wp

from form_drake.laws.kernels import types, update
from form_drake.mpm.simulation import State
from form_drake.records.solver import Solver, Wall

STEPS = Path(__file__).parents[1] / "data" / "steps"
TRUTH = json.loads((STEPS / "truth.json").read_text())
EYE = np.eye(3)
FIELDS = ("x", "v", "C", "L", "F", "tau")


def relative(a, b):
    """Largest difference, relative to the largest entry of b."""
    return np.max(np.abs(a - b)) / np.max(np.abs(b))


@cache
def stored(name):
    """The oracle's arrays and parameters of a law."""
    with np.load(STEPS / f"{name}.npz") as file:
        data = dict(file)
    given = {key[6:]: float(value) for key, value in data.items() if key.startswith("given_")}
    return data, TRUTH[name] | given


def oracle_solver(name, **changes):
    data, _ = stored(name)
    nodes, dx, cells = int(data["nodes"]), float(data["dx"]), int(data["wall_cells"])
    low, high = (cells - 1) * dx, (nodes - cells + 1) * dx
    settings = {
        "dx": dx,
        "nodes": (nodes,) * 3,
        "dt": float(data["dt"]),
        "gradient": str(data["gradient"]),
        "precision": "float64",
        "walls": tuple(
            Wall(axis, side, at) for axis in range(3) for side, at in ((-1, low), (1, high))
        ),
        "mass_eps": float(data["mass_eps"]),
        "gravity": tuple(data["gravity"]),
    }
    return Solver(**settings | changes)


def stored_state(name, i):
    data, _ = stored(name)
    return State(**{key: data[key][i] for key in FIELDS})


def det(F):
    return np.linalg.det(F)


def invariants(F):
    b = np.einsum("nij,nkj->nik", F, F) * (det(F) ** (-2 / 3))[:, None, None]
    first = np.trace(b, axis1=1, axis2=2)
    return first, (first**2 - np.einsum("nij,nji->n", b, b)) / 2


def volumetric(F, modulus):
    return modulus / 2 * (det(F) - 1) ** 2


def derivative(potential, at, h):
    """Central differences of a scalar per point with respect to its 3x3 argument."""
    out = np.empty_like(at)
    for i in range(3):
        for j in range(3):
            step = np.zeros((3, 3))
            step[i, j] = h
            out[:, i, j] = (potential(at + step) - potential(at - step)) / (2 * h)
    return out


def rotations(rng, n):
    q = np.linalg.qr(rng.normal(size=(n, 3, 3)))[0]
    return q * np.linalg.det(q)[:, None, None]


def gradients_of(name, n=200, seed=3):
    """Rotated deformation gradients with stretches of 0.7 to 1.4, and velocity gradients [1/s]."""
    rng = np.random.default_rng(seed)
    stretch = np.exp(rng.uniform(-0.35, 0.35, (n, 3)))
    if name == "mu-i":
        stretch = np.exp(-rng.uniform(0.01, 0.1, (n, 3)))
    F = rotations(rng, n) * stretch[:, None, :] @ rotations(rng, n)
    return F, rng.normal(scale=3.0, size=(n, 3, 3))


def ended(law, values, F, L, *, flows=False, decomposition="series", precision="float64"):
    """F and Kirchhoff stress after the kernel that ends a step, for any law and parameters."""
    t, kernel = types(precision), update(law, decomposition, precision)
    F_ = wp.array(F, dtype=t.mat, device="cpu")
    tau = wp.zeros(len(F), dtype=t.mat, device="cpu")
    constants = np.stack([law.shape_vector(values), law.radius_vector(values)])
    inputs = [
        wp.array([int(flows)], dtype=int, device="cpu"),
        F_,
        wp.array(L, dtype=t.mat, device="cpu"),
        wp.array(law.theta(values), dtype=t.real, device="cpu"),
        wp.array(constants, dtype=t.vec4, device="cpu"),
        tau,
    ]
    wp.launch(kernel, dim=len(F), inputs=inputs, device="cpu")
    return F_.numpy().astype(float), tau.numpy().astype(float)
