"""Probes of a block in which one effect is hidden, by independent finite elements. SI units.

A compressible neo-Hookean block of stated density 1000 kg/m^3 stands on a floor z = 0 that holds
it; the origin is the middle of the floor. ID/ holds, of three identical specimens that start in
static equilibrium,

    press      a plate presses slowly, holds, releases a part, presses fast, oscillates and returns
    shake      free top; the floor moves sideways and a little up and down in two bursts
    heldout    a press of another depth and frequency (not with --small)

The plate is bonded, at first without compression, or frictionless and at first 0.7 % of the height
deep; where ``opens`` a frictionless one ends above the block. Motions have two continuous
derivatives. Draws: ``hidden_effects_cases``; law: ``hidden_effects_material``; what else may be
hidden: ``hidden_effects_probes``; elements and time stepping: ``hidden_effects_solver``. Of the
sensors,

    force-gain, -bias    F (1 + gain), F + bias axis
    force-drift, -delay  F + rate t axis, stamps late by delay
    camera-scale         p (1 + scale) about the origin
    camera-pose          p turned by angle about the axis through the origin

Files: NAME.npz as by ``finite_elements.py``: time (T), p_WQ (T, P, 3) in float32, p_reference
(P, 3), gravity and density as stated, pose_<tool>_value (S, 4, 4) and force_<tool>_value (S, 3),
the force of the material on the tool, each beside its _time (S). NAME.json: geometry, contact,
law. noise.json: seed and standard deviations of the noise that ``noisy`` adds; with --noisy it is
in the files, which then state it (noise, force_plate_noise). The truth goes to the key file alone,
with ``noise`` where the noise is another one than stated.

Where a specimen has no balance (it collapses under what was drawn, say), the coefficients of the
same effects are drawn anew from seed and count, at most four times; the key holds the ``draw``.
"""

import argparse
import json
import time as clock
from pathlib import Path

import numpy as np
from hidden_effects_cases import EFFECTS, GRAVITY, KINDS, OUTSIDE, case_of
from hidden_effects_probes import DENSITY, LAYERS, inside, on_faces, simulated

PROBES = ["press", "shake", "heldout"]
SIGMA, FORCE_NOISE, WAVES = 5e-5, 0.01, 200
DRAWS = 5


def rotation(axis, angle):
    """The rotation (3, 3) by ``angle`` about the unit vector ``axis``."""
    K = np.cross(axis, np.eye(3)).T
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def sensed(found, effects):
    """What the sensors of a case make of what ``simulated`` found."""

    def value(effect, name):
        return np.array(effects.get(effect, {}).get(name, 0.0))

    bias = value("force-bias", "bias") * value("force-bias", "axis")
    drift = value("force-drift", "rate") * value("force-drift", "axis")
    force = found["force"] * (1 + value("force-gain", "gain"))
    force = force + bias + found["stamps"][:, None] * drift
    p = found["p_WQ"] * (1 + value("camera-scale", "scale"))
    if pose := effects.get("camera-pose"):
        p = p @ rotation(pose["axis"], pose["angle"]).T
    late = found["stamps"] + value("force-delay", "delay")
    return found | {"p_WQ": p, "force": force, "force_stamps": late}


def correlated(rng, time, X, length, duration):
    """Gaussian noise (T, P, 3) of variance 1.

    Its correlation over the distance d and the time t is exp(-(d/length)^2/2 - (t/duration)^2/2).
    """
    k, w = rng.normal(size=(WAVES, 3)) / length, rng.normal(size=WAVES) / duration
    a = rng.normal(size=(2, WAVES, 3)) / np.sqrt(WAVES)
    phase = (X @ k.T) + (time[:, None] * w)[:, None]
    return np.cos(phase) @ a[0] + np.sin(phase) @ a[1]


def noisy(arrays, stated, probe, true=None):
    """The arrays of NAME.npz with the noise of a case.

    Args:
        arrays: Content of the file, by name.
        stated: Content of noise.json.
        probe: NAME.
        true: The key's ``noise``: factor on the deviations, or length [m] and time [s] over which
            the noise of positions is correlated.
    """
    true, order = true or {}, PROBES.index(probe)
    rng, factor = np.random.default_rng([stated["seed"], order]), true.get("factor", 1.0)
    p, changed = arrays["p_WQ"].astype(float), {}
    if "length" in true:
        noise = correlated(rng, arrays["time"], arrays["p_reference"], true["length"], true["time"])
    else:
        noise = factor * rng.normal(size=p.shape)
    if (name := "force_plate_value") in arrays:
        force = arrays[name]
        changed[name] = force + factor * stated["sigma_F"][probe] * rng.normal(size=force.shape)
    return dict(arrays) | changed | {"p_WQ": p + stated["sigma_x"] * noise}


def described(body, probe):
    """What NAME.json says."""
    x, y, z = body["size"]
    box = {"low": f"{-x / 2:g} {-y / 2:g} 0", "high": f"{x / 2:g} {y / 2:g} {z:g}"}
    top = "bonded plate" if body["bonded"] else "frictionless plate"
    contact = {"z-": "bonded floor", "z+": "free" if probe == "shake" else top, "other": "free"}
    found = {"geometry": {"shape": "box"} | box, "contact": contact}
    return found | {"law": "neo-hookean", "known": {}}


def saved(path, truth, found):
    """Write NAME.npz and NAME.json."""
    tool = "floor" if path.name == "shake" else "plate"
    arrays = {"time": found["time"], "p_WQ": found["p_WQ"].astype(np.float32)}
    arrays |= {"p_reference": found["points"], "gravity": np.array([0, 0, -GRAVITY])}
    arrays |= {"density": DENSITY, f"pose_{tool}_time": found["stamps"]}
    arrays[f"pose_{tool}_value"] = found["pose"]
    if tool == "plate":
        arrays |= {"force_plate_time": found["force_stamps"], "force_plate_value": found["force"]}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path.with_suffix(".npz"), **arrays)
    stated = json.dumps(described(truth["body"], path.name), indent=1)
    path.with_suffix(".json").write_text(stated + "\n")


def made(truth, folder, level, count, drawn=inside):
    """Simulate a case and write its folder; ``drawn`` says where points are seen."""
    rng = np.random.default_rng([truth["seed"], 2])
    points = drawn(truth["body"], rng, count)
    noise = {"seed": int(rng.integers(2**31)), "sigma_x": SIGMA, "sigma_F": {}}
    for probe in PROBES[: 2 if truth["small"] else 3]:
        found = sensed(simulated(truth, probe, points, level), truth["effects"])
        saved(folder / probe, truth, found | {"points": points})
        if probe != "shake":
            noise["sigma_F"][probe] = FORCE_NOISE * float(np.abs(found["force"]).max())
    (folder / "noise.json").write_text(json.dumps(noise, indent=1) + "\n")


def spoilt(folder, true):
    """Put the noise of a case into its files, and what is stated of it; ``true`` as of ``noisy``."""
    stated = json.loads((folder / "noise.json").read_text())
    for path in folder.glob("*.npz"):
        with np.load(path) as file:
            arrays = noisy(dict(file), stated, path.stem, true)
        if path.stem in stated["sigma_F"]:
            arrays["force_plate_noise"] = stated["sigma_F"][path.stem]
        np.savez_compressed(path, **arrays)
        told = json.loads(path.with_suffix(".json").read_text()) | {"noise": stated["sigma_x"]}
        path.with_suffix(".json").write_text(json.dumps(told, indent=1) + "\n")


def main():
    """Make a case, or check the solver."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", choices=KINDS, default="single")
    parser.add_argument("--effect", choices=[*EFFECTS, *OUTSIDE], help="by default drawn")
    parser.add_argument("--out", type=Path, default=Path("hidden"))
    parser.add_argument("--key", type=Path, help="by default key.json beside the folder --out")
    parser.add_argument("--level", choices=LAYERS, default="medium")
    parser.add_argument("--points", type=int, help="by default 330, with --small 150")
    parser.add_argument("--faces", action="store_true", help="points on two sides, by default 136")
    parser.add_argument("--small", action="store_true", help="shorter motions, no heldout")
    parser.add_argument("--noisy", action="store_true", help="noise in the files, and stated")
    parser.add_argument("--check", action="store_true", help="verify and compare levels; no files")
    args = parser.parse_args()
    if args.check:
        import hidden_effects_check

        return hidden_effects_check.main(args.seed)
    begun, drawn = clock.time(), on_faces if args.faces else inside
    points = args.points or (136 if args.faces else 150 if args.small else 330)
    for draw in range(DRAWS):
        truth = case_of(args.seed, args.kind, args.effect, args.small, draw)
        try:
            made(truth, args.out / truth["id"], args.level, points, drawn)
            if args.noisy:
                spoilt(args.out / truth["id"], truth["noise"])
            break
        except FloatingPointError as error:
            print(f"{truth['id']}, draw {draw}: {error}")
    else:
        raise SystemExit(f"{truth['id']}: no balance in {DRAWS} draws")
    key = args.key or args.out.resolve().parent / "key.json"
    known = json.loads(key.read_text()) if key.exists() else {}
    known[truth["id"]] = truth | {"level": args.level}
    key.write_text(json.dumps(known, indent=1) + "\n")
    print(f"{truth['id']}: {clock.time() - begun:.0f} s")


if __name__ == "__main__":
    main()
