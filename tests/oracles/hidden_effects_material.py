"""Kirchhoff stress of the hidden-effects solids: neo-Hookean with one or more additions. SI units.

All tensors carry their components first and the Gauss points last: F (3, 3, N). With J = det F,
Fbar = J^(-1/3) F, bbar = Fbar Fbar^T, I1 = tr bbar, D = sym(dF/dt F^-1) and P = tau F^-T,

    tau = s(mu) + 4 C2 (I1 - 3) dev bbar + kappa J (J - 1) I
          + 2 J (eta + eta_n (|D|^2 + D0^2)^((n - 1)/2)) dev D + k_f/2 (I4 - 1) (F a)(F a)^T

    elastic         s = mu dev bbar
    relaxation, g   s = (1 - g) mu dev bbar + g mu dev(Fbar H Fbar^T),  dH/dt = (Cbar^-1 - H)/t_r
    yield, tau_y    s = mu dev(Fbar H Fbar^T), |s| <= tau_y + h_y alpha, d alpha/dt = |D_p|, det H = 1
    damage, d       s = mu (1 - d (1 - exp(-max W/W_m))) dev bbar,  W = mu/2 (I1 - 3)

|.| is the Frobenius norm and I4 = |F a|^2. H, the inverse of the inelastic metric, starts at I; at
rest the relaxing branch has relaxed, H = Cbar^-1, exactly followed for Cbar^-1 linear in a step.
An isotropic swelling e puts F/(1 + e) for F in the elastic terms; tau stays per volume before it.
"""

import numpy as np

EYE = np.eye(3)[:, :, None]
RATE = 1e-3  # D0, below which rate dependence turns viscous [1/s]


def mul(a, b):
    """Products (3, 3, N) of matrices."""
    return a[:, :1] * b[0] + a[:, 1:2] * b[1] + a[:, 2:] * b[2]


def turned(a):
    """Transposes (3, 3, N)."""
    return a.transpose(1, 0, 2)


def cofactor(F):
    """J F^-T (3, 3, N)."""
    found = np.empty_like(F)
    for i, k in np.ndindex(3, 3):
        found[i, k] = F[i - 2, k - 2] * F[i - 1, k - 1] - F[i - 2, k - 1] * F[i - 1, k - 2]
    return found


def dev(a):
    """Deviators (3, 3, N)."""
    found = a.copy()
    found[range(3), range(3)] -= np.trace(a) / 3
    return found


def norm(a):
    """Frobenius norms (N)."""
    return np.sqrt(np.einsum("ijn,ijn->n", a, a))


def inverse(C):
    """Inverses (3, 3, N) of symmetric matrices."""
    cof = cofactor(C)
    return cof / np.einsum("jn,jn->n", C[0], cof[0])


def unimodular(s):
    """The tensors s + xi I of determinant 1 with the deviators s (3, 3, N), |s| well below 1.

    xi is the largest root of xi^3 - |s|^2/2 xi + det s - 1 = 0.
    """
    half, det = np.einsum("ijn,ijn->n", s, s) / 2, np.einsum("in,in->n", s[0], cofactor(s)[0])
    xi = 1 + half
    for _ in range(6):
        xi = xi - (xi**3 - half * xi + det - 1) / (3 * xi**2 - half)
    return s + xi * EYE


class Material:
    """The law at Gauss points.

    Attributes:
        p: mu, kappa [Pa] and whichever of C2, k_f, tau_y, h_y, W_m [Pa], eta [Pa s], eta_n [Pa s^n],
            n, g, t_r [s], swelling, damage, a (3), drift [1/s] of both moduli are wanted.
        scale: Factor of mu and kappa at the points (N) or 1.
    """

    def __init__(self, p, scale=1.0):
        """Keep parameters and the scale of the moduli."""
        self.p, self.scale = {"n": 1.0} | p, scale

    def start(self, count):
        """The state of ``count`` stress-free points."""
        state = {}
        if "tau_y" in self.p or "g" in self.p:
            state["H"] = np.repeat(EYE, count, 2)
        if "tau_y" in self.p:
            state["alpha"] = np.zeros(count)
        if "g" in self.p:
            state["before"] = state["H"]
        if "damage" in self.p:
            state["peak"] = np.zeros(count)
        return state

    def stress(self, F, rate, state, time, h):
        """P and the state at the end of a step.

        Args:
            F: Deformation gradients at its end (3, 3, N).
            rate: dF/dt at its end (3, 3, N) [1/s], None at rest.
            state: State at its start.
            time: Its end [s].
            h: Its length [s], infinite towards rest.
        """
        p, swollen = self.p, 1 + self.p.get("swelling", 0.0)
        cof = cofactor(F)
        J = np.einsum("in,in->n", F[0], cof[0])
        if not J.min() > 0.02:
            raise FloatingPointError("crushed")
        drift = self.scale * (1 + p.get("drift", 0.0) * time)
        mu, Je = p["mu"] * drift, J / swollen**3
        Fbar = F * J ** (-1 / 3)
        bbar = mul(Fbar, turned(Fbar))
        tau, state = self.shear(mu, Fbar, bbar, state, h)
        tau = tau + p["kappa"] * drift * Je * (Je - 1) * EYE
        if "C2" in p:
            tau = tau + 4 * p["C2"] * (np.trace(bbar) - 3) * dev(bbar)
        if "k_f" in p:
            Fa = np.einsum("ijn,j->in", F, p["a"]) / swollen
            tau = tau + p["k_f"] / 2 * ((Fa**2).sum(0) - 1) * Fa[:, None] * Fa
        if rate is not None and ("eta" in p or "eta_n" in p):
            D, eta = self.viscosity(rate, cof / J)
            tau = tau + 2 * J * eta * dev(D)
        return mul(tau, cof / J), state

    def shear(self, mu, Fbar, bbar, state, h):
        """The part s of tau with its memory, and the state."""
        if "tau_y" in self.p:
            return self.plastic(mu, Fbar, state)
        if "g" in self.p:
            g, x = self.p["g"], h / self.p["t_r"]
            now, fade = inverse(mul(turned(Fbar), Fbar)), np.exp(-x)
            mean = -np.expm1(-x) / x  # of exp over the step
            H = fade * state["H"] + (1 - mean) * now + (mean - fade) * state["before"]
            b = (1 - g) * bbar + g * mul(mul(Fbar, H), turned(Fbar))
            return mu * dev(b), {"H": H, "before": now}
        if "damage" in self.p:
            peak = np.maximum(state["peak"], mu / 2 * (np.trace(bbar) - 3))
            lost = self.p["damage"] * -np.expm1(-peak / self.p["W_m"])
            return mu * (1 - lost) * dev(bbar), {"peak": peak}
        return mu * dev(bbar), state

    def plastic(self, mu, Fbar, state):
        """The return to the yield surface along dev of the trial, with det H kept at 1.

        (|s_trial| - |s|)/(2 mu tr b/3) is the increment of alpha, b the trial's elastic bbar.
        """
        b = mul(mul(Fbar, state["H"]), turned(Fbar))
        trial, firm = mu * dev(b), 2 * mu * np.trace(b) / 3
        size, h_y = norm(trial), self.p.get("h_y", 0.0)
        radius = self.p["tau_y"] + h_y * state["alpha"]
        more = np.maximum(size - radius, 0) / (firm + h_y)
        s = trial * (1 - firm * more / np.maximum(size, 1e-12))
        back = turned(cofactor(Fbar))
        H = np.where(more > 0, mul(mul(back, unimodular(s / mu)), turned(back)), state["H"])
        return s, {"H": H, "alpha": state["alpha"] + more}

    def viscosity(self, rate, back):
        """D [1/s] with back = F^-T, and the viscosity [Pa s]."""
        p, L = self.p, mul(rate, turned(back))
        D = (L + turned(L)) / 2
        flow = (norm(D) ** 2 + RATE**2) ** ((p["n"] - 1) / 2)
        return D, p.get("eta", 0.0) + p.get("eta_n", 0.0) * flow

    def tangent(self, F, rate, speed, state, time, h):
        """dP_iJ/dF_kL (3, 3, 3, 3, N) [Pa], where dF/dt changes by ``speed`` dF.

        By differences; of viscous stress that at a kept viscosity, since where n < 1/2 Newton's
        own steps overshoot for ever.
        """
        step, A = 1e-7, np.empty((3, 3, 3, 3, F.shape[2]))
        P = self.stress(F, None, state, time, h)[0]
        for k, L in np.ndindex(3, 3):
            moved = F.copy()
            moved[k, L] += step
            A[:, :, k, L] = (self.stress(moved, None, state, time, h)[0] - P) / step
        if rate is not None and ("eta" in self.p or "eta_n" in self.p):
            cof = cofactor(F)
            J = np.einsum("in,in->n", F[0], cof[0])
            A += self.viscous(J, cof / J, rate, speed)
        return A

    def viscous(self, J, back, rate, speed):
        """The share of the viscous stress in the tangent (3, 3, 3, 3, N) [Pa], with back = F^-T."""
        firm = J * speed * self.viscosity(rate, back)[1]
        A = -2 / 3 * firm * back[:, :, None, None] * back
        A += firm * back[:, None, None] * turned(back)[:, :, None]
        metric = firm * mul(turned(back), back)
        for k in range(3):
            A[k, :, k] += metric
        return A
