"""Motions of solids given in closed form, and the body force that makes them exact.

A motion x(X, t) of the reference box has F = dx/dX and, with P = tau F^-T the first Piola-Kirchhoff
stress [Pa] and rho the density of the reference [kg/m^3], the balance of momentum

    rho x'' = Div P + rho (gravity + b)        is solved for        b [m/s^2].

Homogeneous: x_i = l_i(t) X_i with l_i linear in t, gravity 0. Then x'' = 0, Div P = 0, b = 0, and
the tool on the face i+ of reference area A feels the force -P_ii A along i.
Manufactured: x = X + s1 U1(X) + s2 U2(X) + s0 d with s1 = sin^2(w t / 2), s2 = s1^2,
s0 = sin^2(w0 t / 2), d a vector, and waves U(X) = G X + sum_n a_n sin(k_n . X + c_n). Div P by
central differences over STEP (where a yield front cuts through one, a mean of both its sides).

P of the laws, J = det F, I1 = J^(-2/3) tr C, I2 = (I1^2 - J^(-4/3) tr C^2)/2, C = F^T F, W1 = dW/dI1:

    isochoric            2 W1 J^(-2/3) (F - tr C/3 F^-T) + kappa J (J - 1) F^-T
                         + 2 C01 [J^(-4/3) (tr C F - F C) - 2/3 I2 F^-T]
    fixed-corotated      2 mu (F - R) + lam J (J - 1) F^-T,    R = F C^(-1/2)
    weakly-compressible  lam J (J - 1) F^-T
    Hencky               (2 mu e + lam tr(e) I) F^-T,    e = log(F Cp^-1 F^T)/2

with W1 = C10 | C10 | C1 + 2 C2 (I1-3) + 3 C3 (I1-3)^2 | mu/2/(1 - (I1-3)/J_m). Cp^-1 is I at t = 0
and kept in an elastic substep; dev e returns to the radius tau_y/(2 mu) (von-mises) or
-alpha (3 lam + 2 mu)/(2 mu) tr e (drucker-prager; e = 0 where tr e > 0), then
Cp^-1 = F^-1 exp(2 e) F^-T.
"""

from dataclasses import dataclass

import numpy as np

STEP = 1e-6  # [m]
SUBSTEPS = 24
DENSITY, SIDE, CUBE = 1000.0, 0.03, 0.01
PLASTIC = ("von-mises", "drucker-prager")
MODES = {"uniaxial": (2.3, 0.6255, 0.6255), "biaxial": (1.5, 1.5, 0.4), "shear": (2.0, 1.0, 0.45)}
EYE = np.eye(3)


def trace(a):
    """Traces of matrices (..., 3, 3), shaped (..., 1, 1)."""
    return np.trace(a, axis1=-2, axis2=-1)[..., None, None]


def slope(law, i, p):
    """dW/dI1 [Pa] of an isochoric energy at i = I1 - 3."""
    if law == "yeoh":
        return p["C1"] + 2 * p["C2"] * i + 3 * p["C3"] * i**2
    return p["mu"] / 2 / (1 - i / p["J_m"]) if law == "gent" else p["C10"]


def piola(law, F, p):
    """First Piola-Kirchhoff stress (..., 3, 3) [Pa] of an elastic law at F (..., 3, 3)."""
    J = np.linalg.det(F)[..., None, None]
    inverse = np.linalg.inv(F).mT
    C = F.mT @ F
    volume = p["lam" if "lam" in p else "kappa"] * J * (J - 1) * inverse
    if law == "weakly-compressible":
        return volume
    if law == "fixed-corotated":
        squares, axes = np.linalg.eigh(C)
        R = F @ (axes / np.sqrt(squares)[..., None, :]) @ axes.mT
        return 2 * p["mu"] * (F - R) + volume
    q = np.cbrt(J) ** -2
    I1 = q * trace(C)
    P = 2 * slope(law, I1 - 3, p) * q * (F - trace(C) / 3 * inverse) + volume
    if law == "mooney-rivlin":
        I2 = (I1**2 - q**2 * trace(C @ C)) / 2
        P += 2 * p["C01"] * (q**2 * (trace(C) * F - F @ C) - 2 / 3 * I2 * inverse)
    return P


def returned(law, e, p):
    """Principal elastic Hencky strains (N, 3) after the return, and what has yielded (N,)."""
    total = e.sum(-1, keepdims=True)
    shear = e - total / 3
    size = np.linalg.norm(shear, axis=-1, keepdims=True)
    if law == "von-mises":
        kept, radius = total, p["tau_y"] / (2 * p["mu"])
    else:
        kept = np.minimum(total, 0)
        radius = -p["alpha"] * (3 * p["lam"] + 2 * p["mu"]) / (2 * p["mu"]) * kept
    scale = np.minimum(1, radius / np.maximum(size, 1e-300))
    moved = (size > radius) | (total > kept)
    return np.where(moved, kept / 3 + scale * shear, e), moved[:, 0]


def plastic_piola(law, gradient, count, p, times, substeps=SUBSTEPS):
    """First Piola-Kirchhoff stress (T, N, 3, 3) [Pa] along a history, and what yields (T, N).

    Args:
        law: One of PLASTIC.
        gradient: F (N, 3, 3) at a time [s].
        count: N.
        p: Parameters [SI].
        times: Frames (T,) [s], the first at rest.
        substeps: Of a frame.
    """
    plastic = np.tile(EYE, (count, 1, 1))
    stress, yields = np.zeros((len(times), count, 3, 3)), np.zeros((len(times), count), bool)
    for frame in range(1, len(times)):
        for t in np.linspace(times[frame - 1], times[frame], substeps + 1)[1:]:
            F = gradient(t)
            inverse = np.linalg.inv(F)
            squares, axes = np.linalg.eigh(F @ plastic @ F.mT)
            e, moved = returned(law, np.log(squares) / 2, p)
            b = (axes[moved] * np.exp(2 * e[moved])[:, None, :]) @ axes[moved].mT
            plastic[moved] = inverse[moved] @ b @ inverse[moved].mT
        tau = 2 * p["mu"] * e + p["lam"] * e.sum(-1, keepdims=True)
        stress[frame] = (axes * tau[:, None, :]) @ axes.mT @ inverse.mT
        yields[frame] = moved
    return stress, yields


@dataclass(frozen=True)
class Wave:
    """U(X) = G X + sum_n a_n sin(k_n . X + c_n), X from the centre of the box [m]."""

    G: np.ndarray
    a: np.ndarray
    k: np.ndarray
    c: np.ndarray

    def displacement(self, X):
        """U (N, 3) [m] at X (N, 3) [m]."""
        return X @ self.G.T + np.sin(X @ self.k.T + self.c) @ self.a

    def gradient(self, X):
        """dU/dX (N, 3, 3) at X (N, 3) [m]."""
        return self.G + np.einsum("pn,ni,nj->pij", np.cos(X @ self.k.T + self.c), self.a, self.k)


def random_wave(rng, linear, size, *, transverse=False):
    """A wave of three sines whose gradients have at most the Frobenius norm ``size`` in the box.

    Args:
        rng: Random generator.
        linear: G (3, 3), on top of the sines.
        size: Largest norm of the sines' gradient.
        transverse: Without divergence.
    """
    k = rng.uniform(0.5, 1.0, (3, 3)) * rng.choice([-1, 1], (3, 3)) * 0.8 * np.pi / SIDE
    a, c = rng.uniform(-1, 1, (3, 3)), np.pi * rng.uniform(0.25, 0.75, 3)
    if transverse:
        a -= (a * k).sum(1, keepdims=True) / (k**2).sum(1, keepdims=True) * k
    grid = (np.indices((7, 7, 7)).reshape(3, -1).T / 6 - 0.5) * SIDE
    largest = np.linalg.norm(Wave(0 * EYE, a, k, c).gradient(grid), axis=(1, 2)).max()
    return Wave(np.asarray(linear, float), a * size / largest, k, c)


@dataclass(frozen=True)
class Manufactured:
    """The motion x = X + s1 U1 + s2 U2 + s0 d of a box; waves see X from its centre."""

    waves: tuple[Wave, Wave]
    d: np.ndarray
    w: float
    w0: float

    def factors(self, t):
        """s1, s2, s0 at t [s]."""
        s = np.sin(self.w * t / 2) ** 2
        return s, s**2, np.sin(self.w0 * t / 2) ** 2

    def accelerations(self, t):
        """Second derivatives of s1, s2, s0 [1/s^2]."""
        s, _, _ = self.factors(t)
        rate, bend = self.w / 2 * np.sin(self.w * t), self.w**2 / 2 * np.cos(self.w * t)
        return bend, 2 * rate**2 + 2 * s * bend, self.w0**2 / 2 * np.cos(self.w0 * t)

    def combine(self, X, factors):
        """f1 U1(X) + f2 U2(X) + f0 d (N, 3)."""
        f1, f2, f0 = factors
        U1, U2 = (wave.displacement(X - SIDE / 2) for wave in self.waves)
        return f1 * U1 + f2 * U2 + f0 * self.d

    def position(self, X, t):
        """x (N, 3) [m] at t [s]."""
        return X + self.combine(X, self.factors(t))

    def gradient(self, X):
        """The function F(t) (N, 3, 3) at the points X (N, 3)."""
        H1, H2 = (wave.gradient(X - SIDE / 2) for wave in self.waves)
        return lambda t: EYE + self.factors(t)[0] * H1 + self.factors(t)[1] * H2


def manufactured(law, rng):
    """Motion and frame times [s] for a law: 0.5 s to and fro, or 0.3 s of growth if plastic."""
    d = 0.01 * np.array([1.0, 0.6, 0.8]) * rng.choice([-1, 1], 3)
    if law == "drucker-prager":
        shear = np.diag([0.4, 0.2], 1)
        waves = random_wave(rng, -0.07 * EYE, 0.02), random_wave(rng, shear, 0.3, transverse=True)
    elif law == "von-mises":
        shear = np.diag([0.4, 0.2], 1)
        waves = random_wave(rng, 0 * EYE, 0.05), random_wave(rng, shear, 0.3, transverse=True)
    else:
        swell = random_wave(rng, rng.uniform(-0.08, 0.08, (3, 3)), 0.25)
        waves = swell, random_wave(rng, rng.uniform(-0.08, 0.08, (3, 3)), 0.25)
    if law in PLASTIC:
        return Manufactured(waves, d, np.pi / 0.3, 40.0), np.arange(61) / 200
    return Manufactured(waves, d, 15.0, 40.0), np.arange(101) / 200


def piola_divergence(law, motion, X, p, times, substeps=SUBSTEPS):
    """Div P (T, N, 3) [Pa/m] at the points X (N, 3), and what yields (T, N)."""
    points = (X + STEP * np.concatenate([EYE, -EYE])[:, None]).reshape(-1, 3)
    gradient = motion.gradient(points)
    if law in PLASTIC:
        P, yields = plastic_piola(law, gradient, len(points), p, times, substeps)
    else:
        P = np.stack([piola(law, gradient(t), p) for t in times])
        yields = np.zeros(P.shape[:2], bool)
    P = P.reshape(len(times), 2, 3, len(X), 3, 3)
    divergence = np.einsum("tjpij->tpi", P[:, 0] - P[:, 1]) / (2 * STEP)
    return divergence, yields.reshape(len(times), 6, -1).any(1)


def body_force(law, motion, X, p, times, gravity):
    """b (T, N, 3) [m/s^2], and what yields (T, N)."""
    divergence, yields = piola_divergence(law, motion, X, p, times)
    acceleration = np.stack([motion.combine(X, motion.accelerations(t)) for t in times])
    return acceleration - divergence / DENSITY - gravity, yields
