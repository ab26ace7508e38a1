"""What the benches alone may open: the true parameters of the shared data, and the paper's numbers."""

from pathlib import Path

import numpy as np

from form_drake.files import read_mapping
from form_drake.laws.values import lame

MATERIALS = ("jelly", "sand", "plasticine", "water")
LAW = {
    "jelly": "fixed-corotated",
    "sand": "drucker-prager",
    "plasticine": "von-mises",
    "water": "weakly-compressible",
}
MESH = {"jelly": "armadillo", "sand": "blub", "plasticine": "bunny", "water": "spot"}

# mean loss [m^2] and solve time [s] as the FORM paper prints them (Table II)
PAPER = {
    "NCLaw": {
        "jelly": (5.2e-4, 1513.2),
        "sand": (1.6e-4, 1305.6),
        "plasticine": (1.2e-4, 1300.2),
        "water": (5.7e-4, 1306.8),
    },
    "Diff. Sys-Id": {
        "jelly": (1.2e-8, 715.8),
        "sand": (6.3e-13, 1132.8),
        "plasticine": (1.6e-10, 1028.4),
        "water": (4.0e-9, 556.2),
    },
    "Full": {
        "jelly": (5.1e-6, 4.4),
        "sand": (1.4e-8, 2.4),
        "plasticine": (5.2e-7, 4.7),
        "water": (2.3e-6, 2.2),
    },
    "No stress": {
        "jelly": (5.1e-6, 3.5),
        "sand": (2.0e-8, 6.0),
        "plasticine": (5.2e-7, 6.5),
        "water": (2.3e-6, 1.6),
    },
    "Pos. only": {
        "jelly": (1.3e-5, 3.5),
        "sand": (1.0e-5, 12.8),
        "plasticine": (4.6e-6, 21.8),
        "water": (1.0e-2, 4.6),
    },
}


def nclaw_files(data: Path) -> dict[str, Path]:
    """The shared trajectories by ``material/condition``.

    Raises:
        ValueError: the folder lacks one.
    """
    found = {}
    for m in MATERIALS:
        names = {
            "train": f"train_{m}.npz",
            "time": f"eval_time_{m}.npz",
            "velocity": f"eval_velocity1_{m}.npz",
            "geometry": f"eval_geometry_{MESH[m]}_{m}.npz",
        }
        found |= {f"{m}/{condition}": data / name for condition, name in names.items()}
    missing = [p.name for p in found.values() if not p.is_file()]
    if missing:
        raise ValueError(f"{data}: not the shared NCLaw data, it lacks {', '.join(missing[:3])}")
    return found


def true_values(data: Path, material: str) -> dict[str, float]:
    """True parameters of one material, from the ``law`` entry that no reader looks up."""
    law = read_mapping(data / "metadata.json")[f"train_{material}.npz"]["law"]
    mu, lam = lame(float(law["E"]), float(law["nu"]))
    if material == "water":
        return {"lam": lam}
    values = {"mu": mu, "lam": lam}
    if material == "plasticine":
        values["tau_y"] = float(law["yield_stress"])
    if material == "sand":
        sine = np.sin(np.radians(float(law["friction_angle_deg"])))
        values["alpha"] = float(np.sqrt(2.0 / 3.0) * 2.0 * sine / (3.0 - sine))
    return values


def relative_errors(values: dict[str, float], true: dict[str, float]) -> dict[str, float]:
    """Relative error of every true parameter."""
    return {k: values[k] / t - 1.0 for k, t in true.items()}
