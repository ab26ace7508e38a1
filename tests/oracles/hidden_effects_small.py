"""Small cases of hidden effects in compact form, without noise: what a test suite can hold.

NAME.npz holds, for press and shake, displacements as products of ``series`` (T, R) in float32 and
``modes`` (R, 3 P) in float16, together off by half a micrometre (root mean square) at most, and what
else a case of ``hidden_effects.py`` has; poses are places of tools that do not turn. NAME is the state
of the plate and the effect; ``drawn`` is the truth.
"""

import argparse
import json
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from hidden_effects import made, noisy
from hidden_effects_cases import case_of

POINTS, OFF = 100, 5e-7
SEEDS = {"loose": 24, "bonded": 11}
LOOSE = ["null", "drag", "damping", "yield", "tool-friction", "floor-slip", "force-delay", "density",
         "gravity-tilt", "inclusion", "camera-scale", "hidden-wall"]  # fmt: skip
BONDED = ["null", "relaxation", "rate-dependence", "hardening", "stiffening", "anisotropy",
          "eigenstrain", "added-mass", "force-bias", "force-drift", "camera-pose", "crack"]  # fmt: skip
OUTSIDE = {"hidden-wall", "crack"}
CASES = [("loose", name) for name in LOOSE] + [("bonded", name) for name in BONDED]


def drawn(plate, name):
    """The truth of a case."""
    kind = "null" if name == "null" else "outside" if name in OUTSIDE else "single"
    return case_of(SEEDS[plate], kind, None if name == "null" else name, small=True)


def modes(u):
    """Series (T, R) and modes (R, 3 P) of displacements (T, P, 3)."""
    flat = u.reshape(len(u), -1).astype(float)
    _, size, V = np.linalg.svd(flat, full_matrices=False)
    tail = np.sqrt(np.append(np.cumsum(size[::-1] ** 2)[::-1], 0.0) / flat.size)
    kept = V[: int(np.argmax(tail < 0.5 * OFF))].astype(np.float16)
    series = np.linalg.lstsq(kept.T.astype(float), flat.T, rcond=None)[0].T.astype(np.float32)
    if np.sqrt(np.mean((series @ kept.astype(float) - flat) ** 2)) > OFF:
        raise SystemExit("the modes are too coarse for these displacements")
    return series, kept


def packed(folder):
    """Arrays of a case's folder, and what its files state."""
    stated = {"noise": json.loads((folder / "noise.json").read_text())}
    arrays = {}
    for path in sorted(folder.glob("*.npz")):
        stated[path.stem] = json.loads(path.with_suffix(".json").read_text())
        with np.load(path) as file:
            held = dict(file)
        series, kept = modes(held.pop("p_WQ") - held["p_reference"])
        held |= {"series": series, "modes": kept, "p_reference": held["p_reference"].astype("f4")}
        for name, value in held.items():
            if name.startswith("pose_") and name.endswith("_value"):
                held[name] = value[:, :3, 3].astype(np.float32)
            if name.startswith("force_") and name.endswith("_value"):
                held[name] = value.astype(np.float32)
        arrays |= {f"{path.stem}_{name}": value for name, value in held.items()}
    return arrays | {"stated": np.array(json.dumps(stated))}


def unpacked(path, folder):
    """Write the files of a case, with noise, as ``hidden_effects.py`` does."""
    with np.load(path) as file:
        arrays = dict(file)
    stated = json.loads(str(arrays.pop("stated")))
    noise = stated.pop("noise")
    for probe, told in stated.items():
        held = {k[len(probe) + 1 :]: v for k, v in arrays.items() if k.startswith(f"{probe}_")}
        X = held["p_reference"].astype(float)
        u = held.pop("series").astype(float) @ held.pop("modes").astype(float)
        held |= {"p_reference": X, "p_WQ": X + u.reshape(len(u), *X.shape)}
        for name in [k for k in held if k.startswith("pose_") and k.endswith("_value")]:
            X_WT = np.tile(np.eye(4), (len(held[name]), 1, 1))
            X_WT[:, :3, 3] = held[name]
            held[name] = X_WT
        held = noisy(held, noise, probe)
        if probe in noise["sigma_F"]:
            held["force_plate_noise"] = noise["sigma_F"][probe]
        np.savez(folder / f"{probe}.npz", **held)
        (folder / f"{probe}.json").write_text(json.dumps(told | {"noise": noise["sigma_x"]}))


def main():
    """Simulate and write them."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    names = {f"{plate}-{name}": (plate, name) for plate, name in CASES}
    parser.add_argument("--only", nargs="+", choices=names, default=list(names))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.only:
        with TemporaryDirectory() as folder:
            made(drawn(*names[name]), Path(folder), "medium", POINTS)
            np.savez_compressed(args.out / f"{name}.npz", **packed(Path(folder)))
        print(name, flush=True)


if __name__ == "__main__":
    main()
