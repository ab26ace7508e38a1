"""Motions that satisfy the balance of momentum exactly, as tracked points, forces and the truth.

An oracle that shares no code with the package it tests. The flows and their equations stand in
exact_flows.py, the solids in exact_solids.py. CASES names them; the cases of one law have, for one
seed, the same truth (``family``). Points are uniform in the reference box and on its faces, edges
and corners. CASE.npz holds (T frames, P points, S force samples, SI units)

    time [T], p_WQ [T, P, 3], p_reference [P, 3], gravity [3], density
    body_force [T, P, 3]                    force per mass beside gravity, [m/s^2]
    pressure [T, P]                         where it is supplied
    force_<tool>_time [S], force_<tool>_value [S, 3]      of the material on the tool [N]

CASE.json says geometry, contact, law and given constants, CASE.truth.json the parameters.
exact_check.py measures the balance of every case afresh.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import exact_flows
import exact_solids

RANGES = {
    "newtonian": {"eta": (0.35, 0.6)},
    "bingham": {"eta": (20.0, 30.0), "tau_y": (30.0, 45.0)},
    "mu-i": {"mu_s": (0.3, 0.4), "delta_mu": (0.3, 0.4), "I_0": (0.2, 0.3)},
    "mooney-rivlin": {"C10": (6e2, 1e3), "C01": (3e2, 6e2), "kappa": (1e4, 2e4)},
    "yeoh": {"C1": (6e2, 1e3), "C2": (1e2, 2e2), "C3": (2e1, 4e1), "kappa": (1e4, 2e4)},
    "gent": {"mu": (1e3, 2e3), "J_m": (5.0, 8.0), "kappa": (1e4, 2e4)},
    "neo-hookean": {"C10": (2e2, 4e2), "kappa": (1e3, 2e3)},
    "fixed-corotated": {"mu": (5e2, 1e3), "lam": (1e3, 2e3)},
    "von-mises": {"mu": (8e2, 1e3), "lam": (1e3, 2e3), "tau_y": (8e1, 1.2e2)},
    "drucker-prager": {"mu": (8e2, 1e3), "lam": (8e2, 1e3), "alpha": (0.28, 0.32)},
    "weakly-compressible": {"lam": (1e3, 2e3)},
}
GIVEN = {
    "newtonian": {"kappa": 2e4},
    "bingham": {"epsilon": 0.2, "kappa": 2e4},
    "mu-i": {"kappa": 2e4, "grain_diameter": 0.005, "grain_density": 2500.0, "epsilon": 0.2},
}
FLOWS = ("newtonian", "bingham", *exact_flows.MOBILITY)
HOMOGENEOUS = ("mooney-rivlin", "yeoh", "gent")
CASES = (
    *FLOWS,
    *(f"{law}-{mode}" for law in HOMOGENEOUS for mode in exact_solids.MODES),
    *tuple(RANGES)[6:],
)
AXES = "xyz"
GRAVITY = np.array([0.0, 0.0, -9.81])


def law_of(case):
    """Name of the law of a case."""
    return next(law for law in RANGES if case == law or case.startswith(law + "-"))


def truth_of(law, seed):
    """The true parameters of a law by name [SI]."""
    rng = np.random.default_rng([seed, 0, tuple(RANGES).index(law)])
    return {name: float(rng.uniform(*limits)) for name, limits in RANGES[law].items()}


def box_points(rng, low, high, inside, face, edge):
    """Points (P, 3) in a box: ``inside``, ``face`` on each face, ``edge`` on each edge, corners.

    Args:
        rng: Random generator.
        low: Lower corner [m].
        high: Upper corner [m].
        inside: Number in the interior.
        face: Number on each of the six faces.
        edge: Number on each of the twelve edges; 0 leaves out the corners too.
    """
    ends = np.indices((3, 3, 3)).reshape(3, -1).T / 2  # 0.5 means free
    number = np.array([1 if edge else 0, edge, face, inside])[(ends == 0.5).sum(1)]
    ends = np.repeat(ends, number, 0)
    unit = np.where(ends == 0.5, rng.uniform(0, 1, ends.shape), ends)
    return low + unit * (high - low)


def facts_of(law, low, high, contact):
    """Geometry, contact, law and given constants, for json."""
    corners = {"low": low, "high": high}
    box = {name: " ".join(f"{v:.9g}" for v in value) for name, value in corners.items()}
    geometry = {"shape": "box", **box}
    return {"geometry": geometry, "contact": contact, "law": law, "known": GIVEN.get(law, {})}


def make_flow(case, truth, points):
    """Arrays and facts of a flow; points(low, high) draws its points."""
    law = law_of(case)
    flow = exact_flows.flow(case, truth | GIVEN[law])
    X = points(flow.low, flow.high)
    arrays = {"time": flow.times, "p_WQ": flow.track(X, flow.times), "p_reference": X}
    arrays |= {"gravity": flow.gravity, "density": np.array(flow.density)}
    if law == "mu-i":
        arrays["pressure"] = np.tile(flow.pressure(X, 0.0), (len(flow.times), 1))
    return arrays, facts_of(law, flow.low, flow.high, flow.contact)


def make_homogeneous(case, truth, points):
    """Arrays and facts of a cube stretched along its axes in 0.6 s, the forces at 250 Hz."""
    law, cube = law_of(case), exact_solids.CUBE
    final = np.array(exact_solids.MODES[case.removeprefix(law + "-")])
    time, sampled = np.arange(61) / 100, np.arange(151) / 250
    X = points(np.zeros(3), np.full(3, cube))
    stretch = 1 + np.outer(time, final - 1) / time[-1]
    arrays = {"time": time, "p_WQ": stretch[:, None, :] * X, "p_reference": X}
    arrays |= {"gravity": np.zeros(3), "density": np.array(exact_solids.DENSITY)}
    F = (1 + np.outer(sampled, final - 1) / time[-1])[:, :, None] * np.eye(3)
    P = exact_solids.piola(law, F, truth)
    contact = {}
    for i, axis in enumerate(AXES):
        contact |= {
            f"{axis}-": f"frictionless base_{axis}",
            f"{axis}+": f"frictionless pull_{axis}",
        }
        arrays[f"force_pull_{axis}_time"] = sampled
        arrays[f"force_pull_{axis}_value"] = -(cube**2) * P[:, :, i]
    return arrays, facts_of(law, np.zeros(3), np.full(3, cube), contact)


def make_manufactured(law, seed, truth, points):
    """Arrays and facts of a manufactured motion."""
    motion, time = field(law, seed)
    low, high = np.zeros(3), np.full(3, exact_solids.SIDE)
    X = points(low, high)
    force, _ = exact_solids.body_force(law, motion, X, truth, time, GRAVITY)
    arrays = {"time": time, "p_WQ": np.stack([motion.position(X, t) for t in time])}
    arrays |= {"p_reference": X, "gravity": GRAVITY, "body_force": force}
    arrays["density"] = np.array(exact_solids.DENSITY)
    return arrays, facts_of(law, low, high, {"other": "unknown"})


def field(law, seed):
    """Motion and frame times of a manufactured case."""
    rng = np.random.default_rng([seed, 1, CASES.index(law)])
    return exact_solids.manufactured(law, rng)


def make(case, seed, inside=300, face=16, edge=2):
    """Arrays, facts and truth of a case.

    Args:
        case: One of CASES.
        seed: Of the truth, the motion and the points.
        inside: Points in the interior.
        face: Points on each face.
        edge: Points on each edge; 0 leaves out the corners too.
    """
    law = law_of(case)
    truth = truth_of(law, seed)
    rng = np.random.default_rng([seed, 2, CASES.index(case)])

    def points(low, high):
        return box_points(rng, low, high, inside, face, edge)

    if case in FLOWS:
        arrays, facts = make_flow(case, truth, points)
    elif law in HOMOGENEOUS:
        arrays, facts = make_homogeneous(case, truth, points)
    else:
        arrays, facts = make_manufactured(law, seed, truth, points)
    return arrays, facts, truth


def family(law, seed):
    """All cases of one law, by name: the same truth seen in several motions."""
    return {case: make(case, seed) for case in CASES if law_of(case) == law}


def main():
    """Write <case>.npz, <case>.json and <case>.truth.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("case", choices=[*CASES, "all"])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for case in CASES if args.case == "all" else [args.case]:
        arrays, facts, truth = make(case, args.seed)
        np.savez_compressed(args.out / f"{case}.npz", **arrays)
        (args.out / f"{case}.json").write_text(json.dumps(facts, indent=1) + "\n")
        (args.out / f"{case}.truth.json").write_text(json.dumps(truth, indent=1) + "\n")
        print(f"{case}: {arrays['p_WQ'].shape[:2]}")


if __name__ == "__main__":
    main()
