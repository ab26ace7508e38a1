"""Checks of the hidden-effects elements: closed forms, balances, meshes and steps. SI units."""

import argparse
import sys
import time as clock

import numpy as np
from hidden_effects import sensed
from hidden_effects_cases import EFFECTS, OUTSIDE, case_of
from hidden_effects_material import Material
from hidden_effects_mesh import Mesh
from hidden_effects_probes import STEPS, inside, simulated, solver_of, still
from hidden_effects_solver import Solver
from scipy.optimize import brentq

E, NU, DENSITY = 45e3, 0.38, 1000.0
LAW = {"mu": E / (2 * (1 + NU)), "kappa": E / (3 * (1 - 2 * NU))}
NEUTRAL = {"factor": 1.0, "left": 1.0, "tau_y": 1e9}  # coefficients of no influence, else 0


def uniaxial(stretch):
    """Nominal stress [Pa] of a free neo-Hookean bar at an axial stretch."""
    mu, kappa = LAW["mu"], LAW["kappa"]

    def stress(side):
        J = stretch * side**2
        shear = mu * J ** (-2 / 3) * (stretch**2 - side**2)
        return kappa * J * (J - 1) - shear / 3, (kappa * J * (J - 1) + 2 / 3 * shear) / stretch

    return stress(brentq(lambda side: stress(side)[0], 0.5, 2.0, xtol=1e-15))[1]


def compressed():
    """Relative error of the force on a cube between frictionless plates, 10 % compressed."""
    mesh = Mesh([np.array([0, 0.004, 0.01, 0.03])] * 3)
    faces = mesh.X < 1e-9
    top = np.zeros_like(faces)
    top[2] = mesh.X[2] > 0.03 - 1e-9

    def lower(time):
        return np.outer([1, 0, 0], [0, 0, -0.003])

    mass = DENSITY * mesh.volume
    held = [(faces, still), (top, lower)]
    solver = Solver(mesh, Material(LAW), mass, gravity=np.zeros(3), held=held)
    solver.u[2] = -0.1 * mesh.X[2]
    solver.rest()
    return solver.reaction[top].sum() / (uniaxial(0.9) * 0.03**2) - 1


def vibrating(axis, steps=400):
    """Relative error of the lowest frequency of a layer that moves along ``axis`` alone."""
    height, wave = 0.03, LAW["mu"] if axis < 2 else LAW["kappa"] + 4 / 3 * LAW["mu"]
    period = 4 * height / np.sqrt(wave / DENSITY)
    mesh = Mesh([np.linspace(0, 0.01, 2)] * 2 + [np.linspace(0, height, 7)])
    fixed = np.arange(3)[:, None] != axis
    mask = fixed | (mesh.X[2] < 1e-9)
    setting = {"gravity": np.zeros(3), "held": [(mask, still)]}
    solver = Solver(mesh, Material(LAW), DENSITY * mesh.volume, **setting)
    solver.u[axis] = 1e-5 * np.sin(np.pi * mesh.X[2] / (2 * height))
    solver.a = -((2 * np.pi / period) ** 2) * solver.u
    top, tips = np.argmax(mesh.X[2]), []
    for _ in range(2 * steps):
        solver.step(period / steps)
        tips.append(solver.u[axis, top])
    tips = np.array(tips)
    k = np.flatnonzero((tips[:-1] > 0) != (tips[1:] > 0))
    crossings = (k + 1 + tips[k] / (tips[k] - tips[k + 1])) / steps
    return (crossings[2] - crossings[0]) ** -1 - 1


def balanced(truth, rate=480):
    """Largest |reactions + weight - d momentum/dt| by the largest force of a short press."""
    solver, _ = solver_of(truth, "press", "coarse")
    momentum, forces = [], []
    for _ in range(rate // 2):
        solver.step(1 / rate)
        outer = solver.reaction.sum(1) + sum(push.sum(1) for push in solver.pushes)
        forces.append(outer + solver.mass.sum() * solver.gravity[:, 0])
        momentum.append(solver.v @ solver.mass)
    change = (np.array(momentum)[2:] - np.array(momentum)[:-2]) * rate / 2
    size = np.abs(solver.reaction).sum(1).max()
    return np.abs(np.array(forces)[1:-1] - change).max() / size


def known(bonded):
    """A null case at 45 kPa with a bonded or a frictionless plate that never opens."""
    truth = case_of(1, "null")
    truth["body"] |= {"E": E, "nu": NU, "size": [0.04, 0.035, 0.03]}
    truth["body"] |= {"bonded": bonded, "opens": False}
    return truth


def difference(one, other):
    """Of positions [um], rms and largest, and of forces [%]: rms and largest by the largest."""
    d = np.linalg.norm(one["p_WQ"] - other["p_WQ"], axis=-1) * 1e6
    k, m = (len(f["force"]) // (len(other["time"]) - 1) for f in (one, other))
    e = np.linalg.norm(one["force"][::k] - other["force"][::m], axis=-1)
    most = np.linalg.norm(other["force"], axis=-1).max() or 1.0
    e *= 100 / most
    return [np.sqrt((d**2).mean()), d.max(), np.sqrt((e**2).mean()), e.max()]


def converging(truth, probes=("press", "shake")):
    """Print what meshes and steps differ by, one of them at a time from what sets are made with."""
    points = inside(truth["body"], np.random.default_rng(0), 330)
    for probe in probes:
        rate, found = STEPS["medium"] * (1 + (probe == "shake")), {}
        meshes = [(level, rate) for level in ("coarse", "medium", "fine")]
        steps = [("medium", n) for n in (rate // 2, rate, 4 * rate)]
        for trial in dict.fromkeys([*meshes, *steps]):
            begun = clock.time()
            found[trial] = simulated(truth, probe, points, *trial)
            solver, spent = found[trial].pop("solver"), clock.time() - begun
            print(f"{probe} {trial}: {spent:.0f} s, {solver.iterations} iterations,"
                  f" {solver.factorisations} factorisations", file=sys.stderr, flush=True)  # fmt: skip
        for (*others, best), name in (meshes, "{0}"), (steps, "{0}, {1}/s"):
            for one in others:
                row = " ".join(f"{x:8.3f}" for x in difference(found[one], found[best]))
                names = f"{name.format(*one):13} - {name.format(*best):14}"
                print(f"{probe:5}  {names} {row}", flush=True)


def sticking(springs=(2e7, 2e8, 2e9)):
    """Print what springs of friction that sticks [Pa/m] differ by from the stiffest, and their seconds."""
    truth, found = known(False), {}
    points = inside(truth["body"], np.random.default_rng(0), 330)
    for shear in springs:
        begun = clock.time()
        effects = {"tool-friction": {"friction": 0.25, "shear": shear}}
        found[shear] = simulated(truth | {"effects": effects}, "press", points, "coarse")
        print(f"{shear:.0e} Pa/m: {clock.time() - begun:.0f} s", flush=True)
    for shear in springs[:-1]:
        row = " ".join(f"{x:8.3f}" for x in difference(found[shear], found[springs[-1]]))
        print(f"{shear:.0e} - {springs[-1]:.0e}: {row}", flush=True)


def influences(seed, names, level="coarse", *, neutral=False, near=False):
    """Print what effects change in small probes of a seed, or their neutral coefficients."""
    for name in names:
        truth = case_of(seed, "near" if near else "single", name, small=True)
        first = next(iter((EFFECTS | OUTSIDE)[name]))
        first = first if first in truth["effects"][name] else "friction"
        if neutral:
            truth["effects"][name][first] = NEUTRAL.get(first, 0.0)
        plain = truth | {"effects": {}}
        points = inside(truth["body"], np.random.default_rng(0), 150)
        row = f"{name:16} {truth['effects'][name][first]:10.4g}"
        begun = clock.time()
        for probe in ("press", "shake"):
            one = sensed(simulated(truth, probe, points, level), truth["effects"])
            other = simulated(plain, probe, points, level)
            if "delay" in truth["effects"][name]:  # as seen at the stamps
                late = one["stamps"] - truth["effects"][name]["delay"]
                seen = [np.interp(late, one["stamps"], f) for f in one["force"].T]
                one["force"] = np.stack(seen, -1)
            rms, most, force, peak = difference(one, other)
            row += f" | {rms:8.3f} {most:8.3f} {force:7.3f} {peak:7.3f}"
        print(f"{row} | {clock.time() - begun:.0f} s", flush=True)


def main(seed=1, parts=("solid", "converge", "influence"), effects=(*EFFECTS, *OUTSIDE)):
    """Print the checks."""
    if "solid" in parts:
        print(f"uniaxial compression, relative error of the force: {compressed():.1e}")
        for axis, name in (0, "shear"), (2, "pressure"):
            print(f"{name} wave, relative error of the frequency: {vibrating(axis):.1e}")
        for bonded in True, False:
            print(f"momentum, bonded {bonded}, relative residual: {balanced(known(bonded)):.1e}")
    if "converge" in parts:
        print("position [um], rms and largest; force [% of the largest], rms and largest")
        for bonded in True, False:
            print("bonded" if bonded else "frictionless")
            converging(known(bonded), ("press", "shake") if bonded else ("press",))
    if "stick" in parts:
        print("springs of friction: position [um], rms and largest; force [%], rms and largest")
        sticking()
    if "influence" in parts:
        print("effect, coefficient | press: positions, force | shake: positions, force")
        influences(seed, effects)
    for mark, option in ("neutral", {"neutral": True}), ("near", {"near": True}):
        if mark in parts:
            print(f"{mark}: effect, coefficient | press | shake")
            influences(seed, effects, **option)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="*", default=["solid", "converge", "influence"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--effects", nargs="+", default=[*EFFECTS, *OUTSIDE])
    given = parser.parse_args()
    main(given.seed, given.parts, given.effects)
