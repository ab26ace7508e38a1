"""Smoothing of fitted fields by the evidence of the data, and the covariance that it leaves."""

from dataclasses import dataclass

import numpy as np

from form_drake.motion.modes import modes

FLAT = 1e-9  # of the largest roughness, below which a function has none
LEAST = 0.5  # moments that modes leave of an octave, for which a smoothing is chosen
FACTORS = 200  # of smoothing that are compared
# times the likely variance that a mode is granted: what smoothing costs must stay below the noise
UNDER = 10.0


@dataclass(frozen=True)
class Spread:
    """An independent part of the error of a fit, mix (scale z) time_root^T with z white, in the
    functions of ``Fit.roots``.

    Attributes:
        scale: shape [parts, moments or 1].
        time_root: [m], shape [time.size, moments].
        mix: shape [space.size, parts]; None: every function is a part.
    """

    scale: np.ndarray
    time_root: np.ndarray
    mix: np.ndarray | None = None


@dataclass(frozen=True)
class Smoothing:
    """What smoothing keeps of coefficients of white noise, which the data have chosen.

    Attributes:
        modes: orthonormal series of the modes that stand out, shape [moments, modes].
        own: share that is kept of every function in a mode, shape [modes, functions].
        rest: the same in all other series, shape [moments, functions].
    """

    modes: np.ndarray
    own: np.ndarray
    rest: np.ndarray

    @classmethod
    def none(cls, functions: int) -> "Smoothing":
        """Nothing is smoothed."""
        return cls(np.zeros((0, 0)), np.zeros((0, functions)), np.ones((1, functions)))

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Smoothed coefficients, shape of z [moments, functions]."""
        along = self.modes.T @ z
        weak = self.rest * (z - self.modes @ along)
        return np.asarray(self.modes @ (self.own * along - self.modes.T @ weak) + weak)

    def alike(self, weight: np.ndarray) -> "Smoothing":
        """The same for all functions, as it is on average; ``weight`` of every one, shape [functions]."""
        weight = np.maximum(weight, np.finfo(float).tiny)
        own, rest = (np.average(share, axis=1, weights=weight) for share in (self.own, self.rest))
        return Smoothing(self.modes, own[:, None], rest[:, None])

    def spread(self, told: np.ndarray) -> tuple[Spread, ...]:
        """Of what white noise becomes; ``told`` is its variance, shape [functions]."""
        size = np.sqrt(told)
        others = np.eye(len(self.modes)) - self.modes @ self.modes.T
        return (
            Spread((size * self.rest).T, others),
            Spread((size * self.own).T, self.modes),
        )


def smoothing_of(
    z: np.ndarray, roughness: np.ndarray, told: np.ndarray, noise: float, octaves: np.ndarray
) -> tuple[Smoothing, tuple[Spread, ...]]:
    """Smoothing of coefficients of white noise: each mode by itself, and the rest by octaves.

    What stands out of the noise in no mode is slow for the most part: smoothed alike at all
    frequencies, it would be lost where a window gathers it.

    What noise does to a mode is, to first order, what it adds to the field at the mode's series and
    to the series at the mode's field.

    Args:
        z: shape [moments, functions].
        roughness: shape [functions].
        told: variance of each coefficient per square of the noise, at most 1, shape [functions].
        noise: standard deviation of a coefficient that the data tell [m].
        octaves: of the moments' frequencies, shape [moments].

    Returns:
        The smoothing, and the error of the coefficients per unit noise by moments: the share that is
        kept of a function is its variance too.
    """
    U, S, Vt = modes(z, noise)
    weak = z - (U * S) @ Vt
    free = 1.0 - np.sum(U**2, axis=1)
    rest = np.ones(z.shape)
    for octave in np.unique(octaves):
        within = octaves == octave
        if (count := free[within].sum()) > LEAST:
            rest[within] = _share(np.sum(weak[within] ** 2, axis=0) / count, roughness, noise)
    shares, scales, mix = [], [], []
    for size, mode in zip(S, Vt, strict=True):
        own = _share((size * mode) ** 2, roughness, noise)
        own = own * UNDER / (1.0 + own * (UNDER - 1.0))
        shares.append(own)
        scales.append(np.sqrt(told * own))
        beside = np.maximum(own - rest.mean(axis=0), 0.0)
        mix.append(np.sqrt(beside * (told @ mode**2)) * mode)
    others = np.eye(len(z)) - U @ U.T
    own = np.array(shares).reshape(len(S), len(roughness))
    return Smoothing(U, own, rest), (
        Spread(np.sqrt(told * rest).T, others),
        Spread(np.array(scales).reshape(own.shape).T, U),
        Spread(np.ones((len(mix), 1)), others, np.array(mix).reshape(own.shape).T),
    )


def _share(power: np.ndarray, roughness: np.ndarray, noise: float) -> np.ndarray:
    """Share of each function that is likely not noise, where its variance goes by 1 / roughness.

    The factor is the most likely one (evidence); functions without roughness are kept.

    Args:
        power: mean square of the coefficients [m^2], noise included, shape [functions].
        roughness: shape [functions].
        noise: standard deviation of a coefficient [m].
    """
    found = np.ones(len(roughness))
    rough = roughness > FLAT * roughness.max()
    k = roughness[rough]
    if noise <= 0.0 or not len(k):
        return found
    top = max(float(power.max()), noise**2)
    factors = np.geomspace(1e-6 * noise**2 * k.min(), 1e3 * top * k.max(), FACTORS)
    variance = noise**2 + factors[:, None] / k
    cost = np.sum(np.log(variance) + power[rough] / variance, axis=1)
    found[rough] = 1.0 - noise**2 / variance[int(np.argmin(cost))]
    return found
