"""The balance of momentum of the cases of exact_motion.py, measured afresh.

The laws are those of step_mpm.py, every derivative in space and time is a difference of fourth
order with steps of its own, and elastic gradients are carried along by its plastic projection.
Where the yield front runs through a difference, Div P has a jump and no value: left out.
"""

import argparse
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import exact_flows
import exact_motion
import exact_solids
import step_mpm

EYE = np.eye(3)
SPACE = {False: 1e-4, True: 3e-6}  # [m]; True: plastic
TIME = 2e-4  # [s]


def difference(function, x, h):
    """Derivatives (N, ..., 3) along the axes of function(x) (N, ...) at x (N, 3)."""
    points = x + h * np.multiply.outer([1.0, -1.0, 2.0, -2.0], EYE)[:, :, None, :]
    f = function(points.reshape(-1, 3))
    f = f.reshape(4, 3, len(x), *f.shape[1:])
    return np.moveaxis((8 * (f[0] - f[1]) - (f[2] - f[3])) / (12 * h), 0, -1)


def acceleration(track, times):
    """Accelerations (T, N, 3) [m/s^2] of track(times) (T, N, 3), one time after the other."""
    found = []
    for t in times:
        x = track(t + TIME * np.arange(-2.0, 3.0))
        found.append((16 * (x[1] + x[3]) - (x[0] + x[4]) - 30 * x[2]) / (12 * TIME**2))
    return np.stack(found)


def relative(inertia, divergence, force):
    """Largest |inertia - divergence - force| by the largest size of the three, all [N/m^3]."""
    terms = np.stack([inertia, -divergence, -force])
    return float(np.nanmax(np.abs(terms.sum(0))) / np.nanmax(np.abs(terms)))


def cauchy(flow, x, t):
    """Cauchy stress (N, 3, 3) [Pa] of a flow; the pressure of mu-i stands in J."""
    L = difference(lambda y: flow.velocity(y, t), x, 5e-5)
    q = flow.pressure(x, t)[:, None, None]
    if flow.law != "mu-i":
        return step_mpm.fluid(flow.law, np.tile(EYE, (len(x), 1, 1)), L, flow.parameters) - q * EYE
    kappa, z = 1e7, q / 1e7
    for _ in range(9):  # z exp(z) = q / kappa, J = exp(-z)
        z = q / kappa * np.exp(-z)
    tau = step_mpm.fluid("mu-i", np.exp(-z / 3) * EYE, L, flow.parameters | {"kappa": kappa})
    return tau * np.exp(z)


def check_flow(case, seed, arrays, truth):
    """Residuals of a flow at three frames; of its continuity, scaled by the velocity gradient."""
    flow = exact_flows.flow(case, truth | exact_motion.GIVEN[exact_motion.law_of(case)])
    X, frames = arrays["p_reference"], np.linspace(5, len(arrays["time"]) - 2, 3).astype(int)
    times = arrays["time"][frames]
    inertia = flow.density * acceleration(lambda t: flow.track(X, t), times)
    divergence, loss = [], 0.0
    for t, x in zip(times, arrays["p_WQ"][frames], strict=True):
        slopes = difference(lambda y, t=t: cauchy(flow, y, t), x, SPACE[False])
        divergence.append(np.einsum("pijj->pi", slopes))
        L = difference(lambda y, t=t: flow.velocity(y, t), x, SPACE[False])
        loss = max(loss, np.abs(np.trace(L, axis1=1, axis2=2)).max() / np.abs(L).max())
    force = np.broadcast_to(flow.density * flow.gravity, inertia.shape)
    return {"balance": relative(inertia, np.stack(divergence), force), "continuity": float(loss)}


def piola(law, F, elastic, p):
    """First Piola-Kirchhoff stress (N, 3, 3) [Pa] by step_mpm.py."""
    return step_mpm.stress(law, elastic, 0 * F, p) @ np.linalg.inv(F).mT


def history(law, gradient, count, p, times, substeps):
    """P (N, T, 3, 3) [Pa] of a plastic law and whether it yields (N, T), F (N, 3, 3) = gradient(t)."""
    elastic = F = np.tile(EYE, (count, 1, 1))
    found, yields = [np.zeros((count, 3, 3))], [np.zeros(count, bool)]
    for start, end in pairwise(times):
        for n in range(1, substeps + 1):
            F, before = gradient(start + (end - start) * n / substeps), F
            trial = F @ np.linalg.inv(before) @ elastic
            elastic = step_mpm.project(law, trial, p)
        found.append(piola(law, F, elastic, p))
        yields.append((elastic != trial).any((1, 2)))
    return np.stack(found, 1), np.stack(yields, 1)


def divergences(law, motion, X, p, times, substeps):
    """Div P (T, N, 3) [Pa/m] at the points X (N, 3) and all times; nan at the yield front."""

    def stress(points):
        gradient = motion.gradient(points)
        if law not in exact_solids.PLASTIC:
            return np.stack([piola(law, F, F, p) for F in map(gradient, times)], 1)
        P, yields = history(law, gradient, len(points), p, times, substeps)
        share = yields.reshape(-1, len(X), len(times)).mean(0)
        front = np.tile((share > 0) & (share < 1), (len(points) // len(X), 1))
        return np.where(front[:, :, None, None], np.nan, P)

    slopes = difference(stress, X, SPACE[law in exact_solids.PLASTIC])
    return np.einsum("ptijj->tpi", slopes)


def check_manufactured(law, seed, arrays, truth):
    """Residual of the balance; error of F; for plastic laws the residual at twice the substeps."""
    motion, _ = exact_motion.field(law, seed)
    X, time, density = arrays["p_reference"], arrays["time"], float(arrays["density"])

    def track(times):
        return np.stack([motion.position(X, t) for t in times])

    inertia = density * acceleration(track, time[1:-1])
    force = density * (arrays["body_force"] + arrays["gravity"])[1:-1]
    slopes = difference(lambda x: motion.position(x, time[-1]), X, SPACE[False])
    found = {"gradient": float(np.abs(slopes - motion.gradient(X)(time[-1])).max())}
    runs = {"balance": 1, "halved substep": 2}
    for name, factor in list(runs.items())[: 1 + (law in exact_solids.PLASTIC)]:
        substeps = factor * exact_solids.SUBSTEPS
        divergence = divergences(law, motion, X, truth, time, substeps)[1:-1]
        found[name] = relative(inertia, divergence, force)
        found["at the front"] = float(np.isnan(divergence).any(-1).mean())
    return found


def check_homogeneous(law, arrays, truth):
    """Departure from uniform motion; tool forces from the tracks; range of J."""
    X, x = arrays["p_reference"], arrays["p_WQ"]
    H = np.stack([np.linalg.lstsq(X, frame, rcond=None)[0].T for frame in x])
    found = {"balance": float(np.abs(x - X @ H.mT).max() / np.abs(X).max())}
    found["balance"] += float(np.abs(np.diff(x, 2, axis=0)).max() / np.abs(X).max())
    P, area = piola(law, H, H, truth), exact_solids.CUBE**2
    for i, axis in enumerate(exact_motion.AXES):
        both, k, n = np.intersect1d(
            arrays["time"].round(9), arrays[f"force_pull_{axis}_time"].round(9), return_indices=True
        )[:3]
        error = arrays[f"force_pull_{axis}_value"][n] + area * P[k][:, :, i]
        assert len(both) > 20
        found["force"] = max(found.get("force", 0), np.abs(error).max() / np.abs(area * P).max())
    J = np.linalg.det(H)
    return found | {"least J": float(J.min()), "greatest J": float(J.max())}


def check(case, seed=0, points=5):
    """Relative errors of a case by name, measured at a few random points."""
    arrays, _, truth = exact_motion.make(case, seed, points, 0, 0)
    law = exact_motion.law_of(case)
    if case in exact_motion.FLOWS:
        return check_flow(case, seed, arrays, truth)
    if law in exact_motion.HOMOGENEOUS:
        return check_homogeneous(law, arrays, truth)
    return check_manufactured(law, seed, arrays, truth)


def main():
    """Print the errors of every case."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--points", type=int, default=5)
    args = parser.parse_args()
    for case in exact_motion.CASES:
        found = check(case, args.seed, args.points)
        print(f"{case:24}", "  ".join(f"{name} {value:.1e}" for name, value in found.items()))


if __name__ == "__main__":
    main()
