"""What is drawn for a hidden-effects case: specimen, motions, effects and their coefficients.

EFFECTS and OUTSIDE give per effect and coefficient the lowest and highest value, drawn
log-uniformly, what they are multiples of (1, E, E per mm, the height, E times area times strain or
sqrt(2/3) E times strain, at the depth of the press) and "+-" where the sign is drawn. LIMITS are the
least values that a diagnosis of these probes says that it would see, and what they are multiples of:
medians over 18 cases that earlier ranges drew by seed 15001. In kind ``near`` a coefficient that has
one lies within a factor 2 of it; else, but for small cases, those in STRONG are 3 to 30 times as
strong as their limit, as far as EFFECTS goes, to the power that makes them stronger. SI units; angles
in radians.
"""

import hashlib

import numpy as np

GRAVITY = 9.81
PRELOAD = 0.007  # first depth of a frictionless plate, of the height
CUT = 5e-4  # thickness of a crack [m]
KINDS = ["single", "near", "null", "pair", "outside", "noise"]
EFFECTS = {
    "damping": {"eta": (60, 600)},
    "relaxation": {"g": (0.03, 0.3), "t_r": (0.05, 1)},
    "yield": {"tau_y": (0.4, 0.75, "stress")},
    "hardening": {"tau_y": (0.3, 0.65, "stress"), "h_y": (0.1, 0.5, "E")},
    "stiffening": {"C2": (0.3, 2.5, "E")},
    "rate-dependence": {"eta_n": (40, 400), "n": (0.3, 0.7)},
    "anisotropy": {"k_f": (0.1, 1, "E")},
    "inclusion": {"factor": (2.5, 8), "radius": (0.17, 0.28, "height")},
    "eigenstrain": {"swelling": (0.003, 0.03)},
    "gravity-tilt": {"angle": (0.06, 0.35)},
    "density": {"excess": (0.1, 0.5, 1, "+-")},
    "added-mass": {"mass": (2e-3, 1.5e-2), "radius": (3e-3, 6e-3)},
    "drag": {"c": (15, 120)},
    "tool-friction": {"friction": (0.05, 0.5)},
    "adhesion": {"strength": (200, 2000)},
    "floor-slip": {"shear": (0.1, 1, "E/mm"), "friction": (0.1, 0.4)},
    "force-gain": {"gain": (0.03, 0.4, 1, "+-")},
    "force-bias": {"bias": (0.03, 0.2, "force")},
    "force-drift": {"rate": (0.02, 0.1, "force")},
    "force-delay": {"delay": (5e-3, 4e-2)},
    "camera-scale": {"scale": (3e-3, 0.02, 1, "+-")},
    "camera-pose": {"angle": (5e-3, 0.05)},
}
OUTSIDE = {
    "mullins": {"damage": (0.3, 0.7), "W_m": (3e-4, 2e-3, "E")},
    "modulus-drift": {"drift": (0.03, 0.15, 1, "+-")},
    "crack": {"left": (0.01, 0.03)},
    "hidden-wall": {"gap": (1e-5, 2e-4)},
}
LIMITS = {
    "damping": {"eta": (4e-4, "E")},
    "relaxation": {"g": (0.023, 1)},
    "yield": {"tau_y": (1.0, "stress")},
    "hardening": {"tau_y": (0.95, "stress")},
    "stiffening": {"C2": (0.04, "E")},
    "rate-dependence": {"eta_n": (2e-4, "E")},
    "anisotropy": {"k_f": (0.012, "E")},
    "inclusion": {"factor": (1.2, 1)},
    "eigenstrain": {"swelling": (8.5e-5, 1)},
    "gravity-tilt": {"angle": (0.02, 1)},
    "density": {"excess": (0.06, 1)},
    "added-mass": {"mass": (2e-3, 1)},
    "drag": {"c": (1.3e-4, "E")},
    "tool-friction": {"friction": (0.01, 1)},
    "adhesion": {"strength": (4e-3, "E")},
    "floor-slip": {"shear": (0.6, "E/mm"), "friction": (0.8, 1)},
    "force-gain": {"gain": (0.06, 1)},
    "force-bias": {"bias": (7e-3, "force")},
    "force-drift": {"rate": (4e-3, "force")},
    "force-delay": {"delay": (1.5e-3, 1)},
    "camera-scale": {"scale": (8.5e-5, 1)},
    "camera-pose": {"angle": (3.5e-4, 1)},
}
STRONG = dict.fromkeys(LIMITS, 1) | {"floor-slip": -1}
for _other in ("yield", "hardening", "inclusion"):  # their coefficients are no measure of strength
    del STRONG[_other]
MEMORY = {"relaxation", "yield", "hardening", "mullins"}  # at most one of them
PRESS = np.array([(0.15, 0), (1.0, 0.7), (1.15, 0.7), (1.35, 0.35), (1.45, 0.35), (1.65, 1)])
OSCILLATION, RETURN = (1.75, 2.45), (2.45, 2.8)  # of 2.9 s


def path(knots):
    """Value, slope and curvature at time t through knots (K, 2), by 6 u^5 - 15 u^4 + 10 u^3."""
    t, y = np.asarray(knots, float).T

    def value(time):
        k = int(np.clip(np.searchsorted(t, time, "right") - 1, 0, len(t) - 2))
        h, rise = t[k + 1] - t[k], y[k + 1] - y[k]
        u = np.clip((time - t[k]) / h, 0, 1)
        slope, bend = 30 * u**2 * (1 - u) ** 2, 60 * u * (1 - u) * (1 - 2 * u)
        return np.array([y[k] + rise * u**3 * (6 * u**2 - 15 * u + 10), rise * slope / h,
                         rise * bend / h**2])  # fmt: skip

    return value


def burst(start, end, amplitude, frequency):
    """amplitude sin(2 pi frequency (t - start)) under a window that rises until the middle, then falls."""
    window, w = path([(start, 0), ((start + end) / 2, 1), (end, 0)]), 2 * np.pi * frequency

    def value(time):
        e, s, c = window(time), np.sin(w * (time - start)), np.cos(w * (time - start))
        slopes = [e[0] * s, e[1] * s + w * e[0] * c, (e[2] - w**2 * e[0]) * s + 2 * w * e[1] * c]
        return amplitude * np.array(slopes)

    return value


def along(*parts):
    """Motion (3, 3): displacement, velocity, acceleration, of pairs of direction and function."""
    return lambda time: sum(np.outer(f(time), direction) for direction, f in parts)


def plate_motion(start, depth, end, amplitude, frequency, duration):
    """Motion of the plate, all depths in metres, below the undeformed top."""
    t, y = PRESS.T
    knots = np.stack([t, start + (depth - start) * y], -1)
    knots = np.vstack([knots, (RETURN[0], depth), (RETURN[1], end)]) * [duration / 2.9, 1]
    wave = burst(*np.array(OSCILLATION) * duration / 2.9, amplitude, frequency)
    return along(([0, 0, -1], path(knots)), ([0, 0, -1], wave))


def log_uniform(rng, low, high):
    """One number, its logarithm drawn uniformly."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def direction(rng):
    """A unit vector (3) drawn uniformly."""
    a = rng.normal(size=3)
    return (a / np.linalg.norm(a)).tolist()


def specimen(rng, small):
    """Size [m], moduli [Pa], the plate and the motions of a seed."""
    size = np.append(rng.integers(60, 91, 2), rng.integers(50, 71)) * 5e-4
    E, nu = log_uniform(rng, 20e3, 120e3), rng.uniform(0.30, 0.43)
    depth, azimuth = rng.uniform(0.06, 0.10), rng.uniform(0, 2 * np.pi)
    held_out = np.clip(depth * rng.choice([0.75, 1.2]), 0.055, 0.105)
    frequency = rng.permutation([rng.uniform(4, 4.8), rng.uniform(5.2, 6)])
    shake = {"azimuth": azimuth, "slow": rng.uniform(2e-3, 4e-3), "fast": rng.uniform(8e-4, 1.5e-3),
             "rise": rng.uniform(0.2, 0.4), "f_slow": rng.uniform(2.7, 3.4),
             "f_fast": rng.uniform(6.4, 7.4), "duration": 0.3 if small else 1.3}  # fmt: skip
    bonded, opens = rng.random() < 0.5, rng.random() < 0.4
    return {
        "size": size.tolist(), "E": E, "nu": nu, "bonded": bool(bonded), "opens": bool(opens),
        "press": {"depth": depth, "frequency": frequency[0], "duration": 1.2 if small else 2.9},
        "heldout": {"depth": float(held_out), "frequency": frequency[1], "duration": 2.0},
        "shake": shake,
    }  # fmt: skip


def span(effect, name, unit, kind, small):
    """Lowest and highest value of a coefficient, in SI units."""
    low, high, *more = (EFFECTS | OUTSIDE)[effect][name]
    low, high = (x * unit[more[0] if more else 1] for x in (low, high))
    if name not in LIMITS.get(effect, {}):
        return low, high
    limit, of = LIMITS[effect][name]
    limit, power = limit * unit[of], STRONG.get(effect)
    if kind == "near":
        return limit / 2, 2 * limit
    if small or power is None:
        return low, high
    if power < 0:
        return max(limit / 30, low), limit / 3
    return 3 * limit, max(3 * limit, min(30 * limit, high))


def drawn(effect, rng, body, kind="single", small=False):
    """Coefficients of an effect, and its shape: axis, centre, direction, whichever it has."""
    size = np.array(body["size"])
    force = body["E"] * size[0] * size[1] * body["press"]["depth"]
    stress = np.sqrt(2 / 3) * body["E"] * body["press"]["depth"]
    unit = {1: 1, "E": body["E"], "E/mm": body["E"] * 1e3, "height": size[2], "force": force}
    unit["stress"] = stress
    found = {}
    for name, told in (EFFECTS | OUTSIDE)[effect].items():
        x = log_uniform(rng, *span(effect, name, unit, kind, small))
        found[name] = float(x * (rng.choice([-1, 1]) if "+-" in told else 1))
    azimuth, axis = rng.uniform(0, 2 * np.pi), direction(rng)
    centre = (size * rng.uniform([-0.15, -0.15, 0.4], [0.15, 0.15, 0.6])).tolist()
    if effect == "floor-slip":  # one of the two ways
        found.pop("friction" if rng.random() < 0.5 else "shear")
    if effect == "crack":
        side, low = int(rng.integers(2)), rng.uniform(0.15, 0.3)
        found |= {"axis": side, "at": size[side] * rng.uniform(-0.2, 0.2), "thickness": CUT}
        found |= {"z": [size[2] * low, size[2] * rng.uniform(0.7, 0.85)]}
    shapes = {"anisotropy": {"a": axis}, "inclusion": {"centre": centre},
              "added-mass": {"centre": centre}, "gravity-tilt": {"azimuth": azimuth},
              "force-bias": {"axis": axis}, "force-drift": {"axis": axis},
              "camera-pose": {"axis": axis}, "hidden-wall": {"axis": int(rng.integers(2))}}  # fmt: skip
    return found | shapes.get(effect, {})


def chosen(kind, effect, rng):
    """Names of the effects of a case."""
    if kind == "null" or (kind == "noise" and not effect and rng.random() < 0.5):
        return []
    table = list(OUTSIDE if kind == "outside" else EFFECTS)
    names = [effect or str(rng.choice(table))]
    while kind == "pair" and len(names) < 2:
        other = str(rng.choice(table))
        if other not in names and len(MEMORY & {other, *names}) < 2:
            names.append(other)
    return names


def case_of(seed, kind, effect=None, small=False, draw=0):
    """The truth of a case, as the key records it; ``draw`` counts draws of the coefficients."""
    body = specimen(np.random.default_rng([seed, 0]), small)
    rng = np.random.default_rng([seed, 1])
    names = chosen(kind, effect, rng)
    if {"tool-friction", "adhesion"} & set(names):
        body["bonded"], body["opens"] = False, body["opens"] or "adhesion" in names
    rng = np.random.default_rng([seed, 1, draw]) if draw else rng
    effects = {name: drawn(name, rng, body, kind, small) for name in names}
    wrong = [{"factor": 2.0}, {"length": rng.uniform(0.004, 0.012), "time": rng.uniform(0.05, 0.3)}]
    noise = wrong[rng.integers(2)] if kind == "noise" else {}
    name = hashlib.sha256(f"hidden effects {seed} {kind} {effect} {small}".encode())
    return {"id": name.hexdigest()[:10], "seed": seed, "kind": kind, "small": small, "body": body,
            "effects": effects, "noise": noise, "draw": draw}  # fmt: skip
