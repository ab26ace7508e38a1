"""Exact flows of incompressible fluids: a decaying vortex and steady shear on an incline.

Velocity u [m/s] and pressure p [Pa] satisfy div u = 0 and, with D = sym grad u, dev D = D,

    rho (du/dt + (u . grad) u) = -grad p + div s + rho gravity
    newtonian  s = 2 eta D
    bingham    s = 2 eta D + 2 tau_y D / gamma
    mu-i       s = mu(I) p 2 D / gamma,   mu(I) = mu_s + delta_mu I / (I + I_0),
               I = gamma grain_diameter sqrt(grain_density / p)
    gamma = sqrt(2 D : D + epsilon^2)                                          [1/s]

Newtonian: the vortex of Taylor and Green, nu = eta/rho, f = exp(-2 nu k^2 t),

    u = U f (sin kx cos ky, -cos kx sin ky, 0),   p = rho U^2 f^2 (cos 2kx + cos 2ky) / 4.

Bingham and mu-i: u = (u(y), 0, 0) on a plane y = 0 inclined by the angle a, u(0) = 0, free at
y = h, gravity = g (sin a, -cos a, 0), p = rho g cos a (h - y), and s_xy = rho g sin a (h - y) is
at each y one equation for the slope u'(y), which has one root.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

G = 9.81
VORTEX = {"U": 0.038, "k": np.pi / 0.06, "density": 1000.0}
MUD = {"density": 1000.0, "height": 0.02, "angle": np.radians(30.0)}
SAND = {"density": 1500.0, "height": 0.03}
MOBILITY = {"mu-i-1": 0.08, "mu-i-2": 0.2, "mu-i-3": 0.4}  # (tan a - mu_s) / delta_mu


@dataclass(frozen=True)
class Flow:
    """A flow and the box of it that is watched [SI].

    velocity(x, t), pressure(x, t) at points (N, 3); track(x, times) (T, N, 3) from t = 0.
    """

    law: str
    parameters: dict[str, float]
    density: float
    gravity: np.ndarray
    low: np.ndarray
    high: np.ndarray
    contact: dict[str, str]
    times: np.ndarray
    velocity: Callable
    pressure: Callable
    track: Callable


def vortex(parameters):
    """Flow of the decaying vortex."""
    U, k, density = VORTEX.values()
    decay = 2 * parameters["eta"] / density * k**2

    def velocity(x, t):
        a, b = k * x[:, 0], k * x[:, 1]
        wave = np.stack([np.sin(a) * np.cos(b), -np.cos(a) * np.sin(b), 0 * a], 1)
        return U * np.exp(-decay * t) * wave

    def pressure(x, t):
        size = density * (U * np.exp(-decay * t)) ** 2 / 4
        return size * (np.cos(2 * k * x[:, 0]) + np.cos(2 * k * x[:, 1]))

    def track(x, times):
        def rate(t, y):
            return velocity(y.reshape(-1, 3), t).ravel()

        ends = (0.0, max(times[-1], 1e-9))
        path = solve_ivp(rate, ends, x.ravel(), "DOP853", times, rtol=1e-12, atol=1e-15)
        return path.y.T.reshape(len(times), -1, 3)

    low, high = np.array([0.012, 0.006, 0.0]), np.array([0.052, 0.046, 0.02])
    return Flow(
        "newtonian", parameters, density, np.zeros(3), low, high, {"other": "unknown"},
        np.arange(81) / 100, velocity, pressure, track,
    )  # fmt: skip


def increasing_root(function, value, top):
    """x >= 0 with function(x) = value, by bisection on (0, top); function increases.

    Args:
        function: Takes and returns arrays shaped like value.
        value: Values to reach.
        top: Upper bound of every root.
    """
    low, high = np.zeros_like(value), np.full_like(value, top)
    for _ in range(80):
        middle = (low + high) / 2
        over = function(middle) > value
        low, high = np.where(over, low, middle), np.where(over, middle, high)
    return (low + high) / 2


def bingham_profile(p, pull, height):
    """Functions u'(y) [1/s] and u(y) [m/s] of eta u' + tau_y u'/gamma = pull (height - y).

    u = integral of u' dy, and with y given by u' it is closed: pull u = Q(u'(0)) - Q(u'(y)),
    Q(s) = eta s^2 / 2 - tau_y epsilon^2 / gamma(s).

    Args:
        p: eta [Pa s], tau_y [Pa], epsilon [1/s].
        pull: rho g sin a [Pa/m].
        height: Of the free surface above the floor [m].
    """

    def slope(y):
        def friction(s):
            return p["eta"] * s + p["tau_y"] * s / np.hypot(s, p["epsilon"])

        return increasing_root(friction, pull * (height - y), pull * height / p["eta"])

    def integral(s):
        return p["eta"] * s**2 / 2 - p["tau_y"] * p["epsilon"] ** 2 / np.hypot(s, p["epsilon"])

    floor = integral(slope(np.zeros(1)))
    return slope, lambda y: (floor - integral(slope(y))) / pull


def granular_profile(p, density, height, angle):
    """Functions u'(y) [1/s] and u(y) [m/s] of mu(I) u'/gamma = tan a, u by Gauss quadrature."""
    nodes, weights = np.polynomial.legendre.leggauss(60)

    def slope(y):
        size = p["grain_diameter"] * np.sqrt(
            p["grain_density"] / (density * G * np.cos(angle) * (height - y))
        )

        def friction(s):
            gamma = np.hypot(s, p["epsilon"])
            inertia = gamma * size
            return (p["mu_s"] + p["delta_mu"] * inertia / (inertia + p["I_0"])) * s / gamma

        return increasing_root(friction, np.full_like(y, np.tan(angle)), 1e3)

    def speed(y):
        return slope(y[:, None] * (1 + nodes) / 2) @ weights * y / 2

    return slope, speed


def shear_flow(law, p, base, angle, profile, box, contact, times):
    """Flow along x with the profile (u', u) on a plane inclined by the angle [rad]."""
    speed = profile[1]
    low, high = np.zeros(3), np.array(box)

    def velocity(x, t):
        return np.stack([speed(x[:, 1]), 0 * x[:, 0], 0 * x[:, 0]], 1)

    def pressure(x, t):
        return base["density"] * G * np.cos(angle) * (base["height"] - x[:, 1])

    def track(x, times):
        return x + np.asarray(times)[:, None, None] * velocity(x, 0.0)

    gravity = G * np.array([np.sin(angle), -np.cos(angle), 0.0])
    return Flow(
        law, p, base["density"], gravity, low, high, contact, times, velocity, pressure, track
    )


def mud(parameters):
    """Bingham fluid between the floor and its free surface, 0.42 s at 100 Hz."""
    angle, height = MUD["angle"], MUD["height"]
    profile = bingham_profile(parameters, MUD["density"] * G * np.sin(angle), height)
    contact = {"y-": "bonded floor", "y+": "free", "other": "unknown"}
    box, times = (0.04, height, 0.02), np.arange(43) / 100
    return shear_flow("bingham", parameters, MUD, angle, profile, box, contact, times)


def sand(case, parameters):
    """Granular flow below 0.9 of its height, so long that it shears by 1.3 at the floor.

    The inclination follows from MOBILITY, rounded to 0.1 degree; the frame rate is the first of
    50, 100, 200, ... Hz that takes 45 frames.
    """
    tangent = parameters["mu_s"] + MOBILITY[case] * parameters["delta_mu"]
    angle = np.radians(np.round(np.degrees(np.arctan(tangent)), 1))
    height = SAND["height"]
    profile = granular_profile(parameters, SAND["density"], height, angle)
    duration = 1.3 / profile[0](np.zeros(1))[0]
    rate = next(hz for hz in (50, 100, 200, 500, 1000, 2000) if duration * hz > 45)
    times, box = np.arange(int(duration * rate) + 1) / rate, (0.06, 0.9 * height, 0.02)
    contact = {"other": "unknown"}
    return shear_flow("mu-i", parameters, SAND, angle, profile, box, contact, times)


def flow(case, parameters):
    """The flow of a case.

    Args:
        case: newtonian, bingham, or mu-i-1 to mu-i-3.
        parameters: All constants of the law by name, given ones included [SI].
    """
    if case == "newtonian":
        return vortex(parameters)
    return mud(parameters) if case == "bingham" else sand(case, parameters)
