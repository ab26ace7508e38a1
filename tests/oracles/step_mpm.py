"""Reference material point method: small step-resolved trajectories with known parameters.

An oracle that shares no code with the package it tests. Per law it throws a small jittered block
of particles at the walls of a box and stores the states n and n+1 for each n in PAIRS. The two
gradients g alternate over the laws (GRADIENT). The truth is drawn from RANGES and kept apart.
With --positions it stores, for one law, the positions of a rigidly thrown block in float32.

Node i of an axis sits at x_i = i dx; d = x_i - x_p; w = product of three quadratic B-splines;
V0 reference volume; m = density V0. With C = L = 0 and F = I at step 0, one step n -> n+1 is

    tau  = tau(F, L)                                          Kirchhoff stress [Pa]
    m_i  = sum_p w m
    p_i  = sum_p w m (v + C d) - dt sum_p V0 tau g            g = (4/dx^2) w d   ('mls')
    v_i  = p_i / (m_i + mass_eps) + dt gravity                g = grad w at x_p  ('exact')
    v_ia = max(v_ia, 0) if i_a < wall_cells,  min(v_ia, 0) if i_a > nodes - wall_cells
    v    = sum_i w v_i,   C = (4/dx^2) sum_i w v_i d^T,   L = sum_i v_i g^T
    F    = P((I + dt L) F),   x = x + dt v

(p_i/m_i = 0 on a node without mass). The tau stored with state n is tau(F_n, L_n), the one that
drives the step n -> n+1; the stored F is the elastic one, after the projection P.

Notation of the laws: J = det F, bbar = J^(-2/3) F F^T, I1 = tr bbar, F = U diag(s) V^T, R = U V^T,
e = log(F F^T)/2, D = sym L, rate = sqrt(2 dev D : dev D + epsilon^2), I the identity.
"""

import argparse
import json
from pathlib import Path

import numpy as np

DENSITY, DT, DX, NODES, MASS_EPS, WALL_CELLS = 1000.0, 5e-4, 0.1, 14, 1e-7, 3
GRAVITY = np.array([0.0, -9.8, 0.0])
SHAPE, SPACING = np.array([4, 4, 3]), 0.085
EYE, AXES = np.eye(3), np.arange(3)
OFFSETS = np.indices((3, 3, 3)).reshape(3, 27).T

FIRM, SOFT = (2e4, 4e4), (1e4, 2e4)
RANGES = {
    "neo-hookean": {"C10": (1e3, 2e3), "kappa": FIRM},
    "mooney-rivlin": {"C10": (6e2, 1e3), "C01": (4e2, 8e2), "kappa": FIRM},
    "yeoh": {"C1": (6e2, 1e3), "C2": (1e2, 3e2), "C3": (5e1, 1e2), "kappa": FIRM},
    "gent": {"mu": (1e3, 2e3), "J_m": (4.0, 8.0), "kappa": FIRM},
    "fixed-corotated": {"mu": (2e3, 4e3), "lam": FIRM},
    "von-mises": {"mu": (5e3, 1e4), "lam": SOFT, "tau_y": (2e3, 4e3)},
    "drucker-prager": {"mu": SOFT, "lam": SOFT, "alpha": (0.3, 0.4)},
    "newtonian": {"eta": (5.0, 2e1)},
    "bingham": {"eta": (5.0, 2e1), "tau_y": (5e1, 2e2)},
    "mu-i": {"mu_s": (0.3, 0.5), "delta_mu": (0.3, 0.5), "I_0": (0.2, 0.4)},
    "weakly-compressible": {"lam": FIRM},
}
GIVEN = {
    "newtonian": {"kappa": 2e4},
    "bingham": {"epsilon": 0.5, "kappa": 2e4},
    "mu-i": {"kappa": 2e4, "grain_diameter": 0.01, "grain_density": 2500.0, "epsilon": 0.5},
}
LAWS = tuple(RANGES)
GRADIENT = {law: ("mls", "exact")[k % 2] for k, law in enumerate(LAWS)}
PAIRS = dict.fromkeys(LAWS, (100, 200))
PAIRS |= {"von-mises": (50, 360), "drucker-prager": (20, 480), "mu-i": (280, 400)}
HENCKY = ("von-mises", "drucker-prager")
FLUIDS = ("newtonian", "bingham", "mu-i", "weakly-compressible")


def det(a):
    """Determinants of matrices (N, 3, 3), shaped (N, 1, 1)."""
    return np.linalg.det(a)[:, None, None]


def dev(a):
    """Deviators a - tr(a)/3 I of matrices (N, 3, 3)."""
    return a - np.trace(a, axis1=1, axis2=2)[:, None, None] / 3 * EYE


def solid(law, F, p):
    """Kirchhoff stress (N, 3, 3) [Pa] of a solid with elastic gradients F (N, 3, 3)."""
    J = det(F)
    U, s, Vt = np.linalg.svd(F)
    if law in HENCKY:
        e = np.log(s)
        principal = 2 * p["mu"] * e + p["lam"] * e.sum(1, keepdims=True)
        return (U * principal[:, None, :]) @ U.mT
    if law == "fixed-corotated":
        return 2 * p["mu"] * (F - U @ Vt) @ F.mT + p["lam"] * J * (J - 1) * EYE
    bbar = F @ F.mT / np.cbrt(J) ** 2
    I1 = np.trace(bbar, axis1=1, axis2=2)[:, None, None]
    if law == "neo-hookean":
        shear = 2 * p["C10"] * bbar
    elif law == "mooney-rivlin":
        shear = 2 * (p["C10"] * bbar + p["C01"] * (I1 * bbar - bbar @ bbar))
    elif law == "yeoh":
        shear = 2 * sum(i * p[f"C{i}"] * (I1 - 3) ** (i - 1) for i in (1, 2, 3)) * bbar
    else:
        shear = p["mu"] / (1 - (I1 - 3) / p["J_m"]) * bbar
    return dev(shear) + p["kappa"] * J * (J - 1) * EYE


def fluid(law, F, L, p):
    """Kirchhoff stress (N, 3, 3) [Pa] of a fluid with F (N, 3, 3) and L (N, 3, 3) [1/s].

    mu-i has the pressure q = max(-kappa ln(J)/J, 0), the inertial number I = rate d sqrt(rho_s/q)
    of grains of diameter d and density rho_s, and the stress
    J q (mu_s + delta_mu I/(I + I_0)) 2 dev D/rate - J q I; sqrt(q) I is what stays finite.
    """
    J = det(F)
    if law == "weakly-compressible":
        return p["lam"] * J * (J - 1) * EYE
    shear = dev(L + L.mT)
    if law == "newtonian":
        return p["eta"] * J * shear + p["kappa"] * J * (J - 1) * EYE
    rate = np.sqrt((shear**2).sum((1, 2), keepdims=True) / 2 + p["epsilon"] ** 2)
    if law == "bingham":
        return (p["eta"] + p["tau_y"] / rate) * J * shear + p["kappa"] * J * (J - 1) * EYE
    q = np.maximum(-p["kappa"] * np.log(J) / J, 0)
    inertia = rate * p["grain_diameter"] * np.sqrt(p["grain_density"])
    friction = p["mu_s"] + p["delta_mu"] * inertia / (inertia + p["I_0"] * np.sqrt(q))
    return J * q * (friction * shear / rate - EYE)


def stress(law, F, L, p):
    """Kirchhoff stress (N, 3, 3) [Pa], exactly symmetric, of F and L [1/s] (N, 3, 3)."""
    tau = fluid(law, F, L, p) if law in FLUIDS else solid(law, F, p)
    return (tau + tau.mT) / 2


def project(law, F, p):
    """Plastic projection P of trial gradients F (N, 3, 3).

    A fluid keeps its volume alone: J^(1/3) I (mu-i: min(J, 1)^(1/3) I). In a yielding solid dev e
    shrinks to the radius tau_y/(2 mu) (von Mises) or -alpha (3 lam + 2 mu)/(2 mu) tr e
    (Drucker-Prager) at constant tr e; Drucker-Prager without pressure, tr e >= 0, keeps R alone.
    """
    if law in FLUIDS:
        return np.cbrt(np.minimum(det(F), 1) if law == "mu-i" else det(F)) * EYE
    if law not in HENCKY:
        return F
    U, s, Vt = np.linalg.svd(F)
    e = np.log(s)
    trace = e.sum(1, keepdims=True)
    shear = e - trace / 3
    size = np.linalg.norm(shear, axis=1, keepdims=True)
    if law == "von-mises":
        kept, radius = trace, np.full_like(size, p["tau_y"] / (2 * p["mu"]))
    else:
        kept = np.minimum(trace, 0)
        radius = -p["alpha"] * (3 * p["lam"] + 2 * p["mu"]) / (2 * p["mu"]) * kept
    scale = np.divide(radius, size, out=np.ones_like(size), where=size > radius)
    returned = np.exp(kept / 3 + scale * shear)
    moved = (size > radius) | (trace > kept)
    return np.where(moved[:, :, None], (U * returned[:, None, :]) @ Vt, F)


def stencil(x, gradient):
    """The 27 nodes around each particle.

    Args:
        x: Positions (N, 3) [m].
        gradient: 'mls' or 'exact'.

    Returns:
        Flat node index (N, 27), weight w (N, 27), d (N, 27, 3) [m] and gradient g (N, 27, 3) [1/m].
    """
    base = np.floor(x / DX - 0.5)
    f = (x / DX - base)[:, None, :]
    spline = np.concatenate([0.5 * (1.5 - f) ** 2, 0.75 - (f - 1) ** 2, 0.5 * (f - 0.5) ** 2], 1)
    slope = np.concatenate([f - 1.5, 2 - 2 * f, f - 0.5], 1) / DX
    n, dn = spline[:, OFFSETS, AXES], slope[:, OFFSETS, AXES]
    node = base[:, None, :].astype(int) + OFFSETS
    index = np.ravel_multi_index(tuple(np.moveaxis(node, 2, 0)), (NODES,) * 3)
    w, d = n.prod(2), node * DX - x[:, None, :]
    exact = dn * n[..., [1, 2, 0]] * n[..., [2, 0, 1]]
    return index, w, d, exact if gradient == "exact" else 4 / DX**2 * w[..., None] * d


def grid_velocity(index, mass, momentum):
    """Velocities (NODES^3, 3) [m/s] of the nodes, gravity and walls included.

    Args:
        index: Flat node index (N, 27).
        mass: What each particle adds to the mass of each node (N, 27) [kg].
        momentum: What it adds to the momentum, force included (N, 27, 3) [kg m/s].
    """
    m = np.bincount(index.ravel(), mass.ravel(), NODES**3)[:, None]
    p = np.zeros((NODES**3, 3))
    np.add.at(p, index, momentum)
    v = np.divide(p, m + MASS_EPS, out=np.zeros_like(p), where=m > 0) + DT * GRAVITY
    node = np.indices((NODES,) * 3).reshape(3, -1).T
    v = np.where(node < WALL_CELLS, np.maximum(v, 0), v)
    return np.where(node > NODES - WALL_CELLS, np.minimum(v, 0), v)


def advance(law, state, volume, p):
    """One step n -> n+1.

    Args:
        law: Name of the law.
        state: x, v (N, 3), C, L, F and tau (N, 3, 3) by name [SI].
        volume: Reference volumes (N,) [m^3].
        p: Parameters by name [SI].

    Returns:
        The next state, with the stress that drives the step after it.
    """
    x, v, C, _, F, tau = state.values()
    index, w, d, g = stencil(x, GRADIENT[law])
    mass = DENSITY * volume[:, None] * w
    force = -volume[:, None, None] * (g @ tau.mT)
    momentum = mass[..., None] * (v[:, None, :] + d @ C.mT) + DT * force
    node_v = grid_velocity(index, mass, momentum)[index]
    v = np.einsum("pi,pia->pa", w, node_v)
    C = 4 / DX**2 * np.einsum("pi,pia,pib->pab", w, node_v, d)
    L = np.einsum("pia,pib->pab", node_v, g)
    F = project(law, F + DT * L @ F, p)
    return {"x": x + DT * v, "v": v, "C": C, "L": L, "F": F, "tau": stress(law, F, L, p)}


def block(rng, *, rigid=False):
    """Positions (N, 3) [m], velocities (N, 3) [m/s] and volumes (N,) [m^3] of a random block.

    It moves rigidly towards the floor; unless ``rigid``, it also squeezes itself and carries a
    smooth wave.
    """
    r = (np.indices(SHAPE).reshape(3, -1).T - (SHAPE - 1) / 2) * SPACING
    r += SPACING * rng.uniform(-0.2, 0.2, r.shape)
    centre = DX * (np.array([7.0, 4.2, 7.0]) + rng.uniform(-0.5, 0.5, 3))
    linear = np.array([0.0, -2.0, 0.0]) + rng.uniform(-1, 1, 3)
    v = linear + np.cross(rng.uniform(-4, 4, 3), r)
    if not rigid:
        v = v - 4 * r
        v += 2 * np.sin(r @ rng.uniform(-15, 15, (3, 3)) + rng.uniform(0, 2 * np.pi, 3))
    return centre + r, v, SPACING**3 * rng.uniform(0.9, 1.1, len(r))


def trajectory(law, seed):
    """The arrays to store and the true identified parameters of one law, both by name [SI]."""
    given, pairs = GIVEN.get(law, {}), PAIRS[law]
    rng = np.random.default_rng([seed, LAWS.index(law)])
    truth = {name: float(rng.uniform(*limits)) for name, limits in RANGES[law].items()}
    x, v, volume = block(rng)
    p = truth | given
    zero, F = np.zeros((len(x), 3, 3)), np.tile(EYE, (len(x), 1, 1))
    states = [{"x": x, "v": v, "C": zero, "L": zero, "F": F, "tau": stress(law, F, zero, p)}]
    for _ in range(pairs[-1] + 1):
        states.append(advance(law, states[-1], volume, p))
    steps = [n + k for n in pairs for k in (0, 1)]
    arrays = {key: np.stack([states[n][key] for n in steps]) for key in states[0]}
    arrays |= {"step": np.array(steps), "x0": x, "v0": v, "volume": volume}
    return arrays | settings(law), truth


def positions(law, seed, every, frames):
    """Positions alone of a rigidly thrown block, every so many steps, and the true parameters."""
    rng = np.random.default_rng([seed, LAWS.index(law)])
    truth = {name: float(rng.uniform(*limits)) for name, limits in RANGES[law].items()}
    x, v, volume = block(rng, rigid=True)
    p = truth | GIVEN.get(law, {})
    zero, F = np.zeros((len(x), 3, 3)), np.tile(EYE, (len(x), 1, 1))
    state = {"x": x, "v": v, "C": zero, "L": zero, "F": F, "tau": stress(law, F, zero, p)}
    seen = [x]
    for _ in range(frames - 1):
        for _ in range(every):
            state = advance(law, state, volume, p)
        seen.append(state["x"])
    arrays = {"x": np.stack(seen).astype(np.float32), "step": every * np.arange(frames)}
    return arrays | {"x0": x, "v0": v, "volume": volume} | settings(law), truth


def settings(law):
    """What the reader of a trajectory has to know of the solver and of the law."""
    arrays = {"density": DENSITY, "dt": DT, "dx": DX, "nodes": NODES, "mass_eps": MASS_EPS}
    arrays |= {"wall_cells": WALL_CELLS, "gravity": GRAVITY, "gradient": GRADIENT[law]}
    return arrays | {f"given_{name}": value for name, value in GIVEN.get(law, {}).items()}


def main():
    """Write <law>.npz for every law, or the positions of one law, and truth.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--positions", choices=LAWS, help="positions alone of this law")
    parser.add_argument("--every", type=int, default=4, help="steps from one frame to the next")
    parser.add_argument("--frames", type=int, default=101)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    truths = {}
    for law in [args.positions] if args.positions else LAWS:
        if args.positions:
            arrays, truths[law] = positions(law, args.seed, args.every, args.frames)
        else:
            arrays, truths[law] = trajectory(law, args.seed)
        np.savez_compressed(args.out / f"{law}.npz", **arrays)
    (args.out / "truth.json").write_text(json.dumps(truths, indent=1) + "\n")


if __name__ == "__main__":
    main()
