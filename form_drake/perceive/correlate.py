"""Digital image correlation: parts of a first picture, found again in later ones to thousandths of a pixel.

A part is matched by inverse-compositional Gauss-Newton steps on the zero-mean normalised squared
difference (Baker and Matthews 2004; Pan, Li and Tong 2013). What brightness, contrast and blur do (pixels
too, which are blurs that do not deform) is projected off its slopes once, so that a step is one product
with the sampled picture. Always it is the first picture that is sought: nothing drifts.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import warp as wp
from scipy.fft import irfft2, next_fast_len, rfft2

from form_drake.perceive.kernels import row, stepping, vec
from form_drake.perceive.splines import MARGIN, read
from form_drake.perceive.warps import AFFINE, SIZE, monomials

FLAT = 1e-6  # of the strongest direction, from which texture shows a warp
TINY = 1e-300
REACH = 6  # pixels, within which what is left of them is alike
ALIKE = 0.8  # correlation, below which a part is lost
FAINT = 1.0  # grey value, root mean square, from which there is texture


def grid(half: int) -> np.ndarray:
    """Pixels of a part from its middle [px], shape [pixels, 2]."""
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    return np.stack([x.ravel(), y.ravel()], axis=-1).astype(float)


@dataclass(frozen=True)
class Parts:
    """Square parts of a first picture.

    Attributes:
        middle: x to the right and y down [px], shape [parts, 2].
        half: pixels from the middle to the rim.
        free: numbers of a warp that are found, 6 or 12.
        values: grey values less their mean, shape [parts, pixels].
        mean: that mean, shape [parts].
        light: what brightness, contrast and blur change, orthonormal, shape [parts, pixels, 5].
        steps: of a warp by grey values; none where texture shows none, shape [parts, 12, pixels].
        shows: whether texture shows how they move, shape [parts].
        device: Warp device on which they are sought.
    """

    middle: np.ndarray
    half: int
    free: int
    values: np.ndarray
    mean: np.ndarray
    light: np.ndarray
    steps: np.ndarray
    shows: np.ndarray
    device: str = "cpu"

    @classmethod
    def of(
        cls,
        picture: np.ndarray,
        middle: np.ndarray,
        half: int,
        *,
        affine: bool = False,
        device: str = "cpu",
    ) -> "Parts":
        """Cut out of a picture.

        Args:
            picture: coefficients of its spline, shape [rows, columns].
            middle: of the parts [px], shape [parts, 2].
            half: pixels from the middle to the rim.
            affine: whether warps are of first order, instead of second.
            device: Warp device on which they are sought.

        Raises:
            ValueError: a part leaves the picture.
        """
        high = np.array(picture.shape[::-1]) - 1.0
        room = np.minimum(middle, high - middle).min(axis=1) - half - MARGIN
        if room.min(initial=0.0) < 0.0:
            raise ValueError(
                f"a part at {place(middle[room.argmin()])} px leaves the picture of {high[0] + 1:g} x"
                f" {high[1] + 1:g} px; its rim is {half} px from its middle"
            )
        told = read(picture, middle[:, None] + grid(half))
        terms = monomials(grid(half))
        columns = np.concatenate([told[k][..., None] * terms for k in "xy"], axis=-1)
        chosen = list(AFFINE if affine else range(SIZE))
        mean = told[""].mean(axis=1)
        values = told[""] - mean[:, None]
        bends = [told[k] for k in ("xx", "xy", "yy")]
        light = np.linalg.qr(np.stack([np.ones_like(values), values, *bends], axis=-1))[0]
        faint = np.sqrt(np.mean(values**2, axis=1)) < FAINT
        steps = np.zeros((len(middle), SIZE, values.shape[1]))
        shows, steps[:, chosen] = _solved(columns[..., chosen], light, faint)
        return cls(middle, half, len(chosen), values, mean, light, steps, shows, device)

    @cached_property
    def arrays(self) -> list[Any]:
        """Middles, pixels, values, means and steps on the device."""
        return [
            wp.array(np.ascontiguousarray(a), dtype=kind, device=self.device)
            for a, kind in (
                (self.middle, wp.vec2d),
                (grid(self.half), wp.vec2d),
                (self.values.astype(np.float32), wp.float32),
                (self.mean.astype(np.float32), wp.float32),
                (self.steps.transpose(0, 2, 1).astype(np.float32), row),
            )
        ]

    @cached_property
    def spread(self) -> np.ndarray:
        """Covariance of the middles where grey values of pixels at a distance vary together by one.

        Returns:
            [px^2], shape [parts, 2, 2, 2 REACH + 1, 2 REACH + 1].
        """
        own = self.steps[:, [0, 6]].reshape(len(self.middle), 2, *self.square)
        return _beside(own[:, :, None], own[:, None])

    @property
    def square(self) -> tuple[int, int]:
        """Rows and columns of pixels."""
        return (2 * self.half + 1,) * 2


def _beside(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Sums of what two pictures have at pixels of a distance, up to ``REACH`` either way.

    Args:
        a: shape [..., rows, columns].
        b: the same.

    Returns:
        Shape [..., 2 REACH + 1, 2 REACH + 1].
    """
    size = [next_fast_len(n + REACH, real=True) for n in a.shape[-2:]]
    both = np.conj(rfft2(a, size)) * rfft2(b, size)
    lags = np.arange(-REACH, REACH + 1)
    found: np.ndarray = irfft2(both, size)[..., lags[:, None], lags]
    return found


def _together(left: np.ndarray) -> np.ndarray:
    """How alike what is left of pixels is by their distance, shape [2 REACH + 1, 2 REACH + 1].

    Every part counts alike, whatever it leaves. Bartlett's window keeps variances positive (Newey and
    West 1987).

    Args:
        left: of parts, shape [parts, rows, columns].
    """
    size = np.sqrt(np.mean(left**2, axis=(1, 2), keepdims=True))
    left = left / np.maximum(size, TINY)
    found = _beside(left, left).sum(axis=0)
    share = 1.0 - np.abs(np.arange(-REACH, REACH + 1)) / (REACH + 1.0)
    return np.asarray(found / max(found[REACH, REACH], TINY) * share * share[:, None])


def place(pixel: np.ndarray) -> str:
    """A pixel in words."""
    return f"({pixel[0]:.1f}, {pixel[1]:.1f})"


def _solved(
    columns: np.ndarray, light: np.ndarray, faint: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which parts show how they move, and steps by grey values, shape [parts, numbers, pixels]."""
    columns = columns - light @ (light.transpose(0, 2, 1) @ columns)
    length = np.maximum(np.linalg.norm(columns, axis=1), TINY)
    columns = columns / length[:, None]
    normal = columns.transpose(0, 2, 1) @ columns
    shows = ~faint & (np.linalg.eigvalsh(normal)[:, 0] >= FLAT)
    columns[~shows], normal[~shows] = 0.0, np.eye(normal.shape[1])
    steps: np.ndarray = np.linalg.solve(normal, columns.transpose(0, 2, 1)) / length[..., None]
    return shows, steps


@dataclass(frozen=True)
class Matches:
    """Parts in a later picture.

    Attributes:
        warps: shape [parts, 12].
        likeness: correlation of grey values, 1 at best, shape [parts].
        settled: whether the steps came to rest inside the picture, shape [parts].
        covariance: of the middles [px^2], from the grey values that are left, shape [parts, 2, 2].
    """

    warps: np.ndarray
    likeness: np.ndarray
    settled: np.ndarray
    covariance: np.ndarray

    @property
    def shift(self) -> np.ndarray:
        """Of the middles [px], shape [parts, 2]."""
        return self.warps[:, [0, 6]]


def matched(parts: Parts, picture: np.ndarray, start: np.ndarray) -> Matches:
    """Parts of a first picture in another one.

    Args:
        parts: of the first.
        picture: coefficients of the other's spline, shape [rows, columns].
        start: warps to begin with, within a speckle of the truth, shape [parts, 12].
    """
    (count, pixels), device = parts.values.shape, parts.device
    other = wp.array(picture.astype(np.float32), dtype=wp.float32, device=device)
    warps = wp.array(start, dtype=vec, device=device)
    told = wp.zeros(count, dtype=wp.vec2d, device=device)
    left = wp.zeros((count, pixels), dtype=wp.float32, device=device)
    inputs, outputs = [other, *parts.arrays, float(parts.half)], [warps, told, left]
    wp.launch(stepping(), count, inputs, outputs, device=device)
    ended, likeness = told.numpy().T
    settled = parts.shows & (ended > 0.0)
    rest = left.numpy()[..., None].astype(float)
    rest -= parts.light @ (parts.light.transpose(0, 2, 1) @ rest)
    freedom = pixels - parts.free - parts.light.shape[2]
    variance = np.sum(rest[..., 0] ** 2, axis=1) / freedom
    found = settled & (likeness > ALIKE)
    alike = _together(rest.reshape(count, *parts.square)[found])
    covariance = np.tensordot(parts.spread, alike, 2) * variance[:, None, None]
    return Matches(warps.numpy(), likeness, settled, covariance)
