"""Solids that remember: a share of the stress answers to what is left of the deformation.

Beside the whole deformation F there are elastic parts F_m, of which every one forgets some of the
deviator of its Hencky strain: with time, beyond a yield strain, or both. The stress is

    tau = (1 - sum_m s_m) tau(F) + sum_m s_m tau(F_m),

as of springs, Maxwell elements and sliders in parallel (Besseling 1958; Simo and Hughes 1998).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from form_drake.laws.kernels import strain, stress, types
from form_drake.laws.law import Law
from form_drake.laws.tensor import deviator, exponential, hencky, isochoric_b, norm

LARGEST = 2e-3  # strain in a stride along a history
NEVER = 1e9  # a strain, or a rate [1/s], without bound


@dataclass(frozen=True)
class Memory:
    """One elastic part.

    Attributes:
        share: of the stress that it bears.
        rate: at which it relaxes [1/s].
        strain: |dev e| at which it yields.
        growth: by how much that grows with the plastic strain, d strain / d |dev e_p|.
    """

    share: float
    rate: float = 0.0
    strain: float = NEVER
    growth: float = 0.0

    @property
    def vector(self) -> tuple[float, float, float, float]:
        """As kernels read it."""
        return self.share, min(self.rate, NEVER), min(self.strain, NEVER), self.growth


@cache
def forget(precision: str):
    """Warp function (trial F_m, plastic strain, dt, constants) -> F_m after a step, plastic strain.

    ``constants`` are those of ``Memory.vector``.
    """
    t = types(precision)
    real = t.real
    measure, exp = hencky("series", precision), exponential(precision)

    @wp.func
    def function(F: t.mat, plastic: real, dt: real, c: t.vec4):
        J = wp.determinant(F)
        if c[1] <= real(0.0) and J > real(0.0):
            far = norm(isochoric_b(F, J) - wp.identity(n=3, dtype=real))
            # |log b| <= |b - I| / (1 - |b - I|), twice the strain: surely elastic
            if far < (real(1.0) - far) * real(2.0) * (c[2] + c[3] * plastic):
                return F, plastic
        d = deviator(measure(F))
        kept = wp.exp(-dt * c[1])
        size = kept * norm(d)
        more = wp.max(size - c[2] - c[3] * plastic, real(0.0)) / (real(1.0) + c[3])
        if size > real(0.0):
            kept *= real(1.0) - more / size
        return exp((kept - real(1.0)) * d) * F, plastic + more

    return function


@cache
def remember(law: Law, decomposition: str, precision: str):
    """Kernel that ends a step of an elastic law that remembers: F_m <- forget(trial F_m), tau.

    Where ``project`` is 0, parts are taken as they are.
    """
    t, left = types(precision), forget(precision)
    evaluate, measure = (of(law, decomposition, precision) for of in (stress, strain))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        project: wp.array(dtype=int),
        clock: wp.array(dtype=t.vec4),
        memories: wp.array(dtype=t.vec4),
        F: wp.array(dtype=t.mat),
        L: wp.array(dtype=t.mat),
        theta: wp.array(dtype=t.real),
        constants: wp.array(dtype=t.vec4),
        parts: wp.array2d(dtype=t.mat),
        plastic: wp.array2d(dtype=t.real),
        tau: wp.array(dtype=t.mat),
    ):
        i = wp.tid()
        dt = clock[0][0]
        whole = evaluate(F[i], measure(F[i]), L[i], theta, constants[0])
        total = whole
        for m in range(memories.shape[0]):
            part = parts[m, i]
            if project[0] != 0:
                moved = part + dt * (L[i] * part)
                part, more = left(moved, plastic[m, i], dt, memories[m])
                parts[m, i] = part
                plastic[m, i] = more
            own = evaluate(part, measure(part), L[i], theta, constants[0])
            total += memories[m][0] * (own - whole)
        tau[i] = total

    return kernel


@cache
def history():
    """Kernel (F[time, point], time, constants) -> F_m[time, point].

    F moves straight from one time to the next in strides no longer than ``LARGEST``. What relaxes has
    relaxed at the start, and does so for half of a stride's time before it and for half after it (Strang
    1968): frames may be few for what relaxes soon.
    """
    t = types("float64")
    left, largest = forget("float64"), wp.constant(t.real(LARGEST))

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        F: wp.array2d(dtype=t.mat),
        time: wp.array(dtype=t.real),
        constants: t.vec4,
        out: wp.array2d(dtype=t.mat),
    ):
        i = wp.tid()
        rest = t.real(0.0)
        if constants[1] > t.real(0.0):
            rest = t.real(NEVER)
        part, plastic = left(F[0, i], t.real(0.0), rest, constants)
        out[0, i] = part
        last = F[0, i]
        for n in range(1, F.shape[0]):
            stride = F[n, i] - F[n - 1, i]
            count = 1 + int(wp.sqrt(wp.ddot(stride, stride)) / largest)
            half = t.real(0.5) * (time[n] - time[n - 1]) / t.real(count)
            for k in range(1, count + 1):
                if constants[1] > t.real(0.0):
                    part, plastic = left(part, plastic, half, constants)
                now = F[n - 1, i] + t.real(k) / t.real(count) * stride
                part, plastic = left(now * wp.inverse(last) * part, plastic, half, constants)
                last = now
            out[n, i] = part

    return kernel


def remembered(F: np.ndarray, time: np.ndarray, memory: Memory) -> np.ndarray:
    """What an elastic part is along a motion.

    Args:
        F: deformation gradients, shape [times, points, 3, 3].
        time: [s], shape [times].
        memory: of the part.

    Returns:
        shape [times, points, 3, 3].
    """
    t = types("float64")
    total = wp.array(np.ascontiguousarray(F, dtype=float), dtype=t.mat, device="cpu")
    out = wp.empty(F.shape[:2], dtype=t.mat, device="cpu")
    stamps = wp.array(np.ascontiguousarray(time, dtype=float), dtype=t.real, device="cpu")
    inputs = [total, stamps, t.vec4(*memory.vector), out]
    wp.launch(history(), dim=F.shape[1], inputs=inputs, device="cpu")
    return out.numpy().copy()


def vectors(memories: Sequence[Memory]) -> np.ndarray:
    """As the kernel of a step reads them, shape [memories, 4]."""
    return np.array([m.vector for m in memories], dtype=float).reshape(-1, 4)
