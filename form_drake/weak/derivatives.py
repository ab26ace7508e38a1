"""Warp kernels of the weak form: derivatives of a law's stress, all at a point."""

from functools import cache

import warp as wp

from form_drake.laws import Law
from form_drake.weak.kernels import followed, mat, real, response, vec3, vec4

slopes = wp.array3d(dtype=real)  # [point, entry of the image, entry of the matrix]


@cache
def strides(law: Law):
    """Kernel: first Piola stress after a stride and its derivatives, see ``weak.tangent.stride``.

    Turns of a body turn its stress; only stretches are tried.
    """
    evaluate, follow, plastic = response(law), followed(law), law.flow == "plastic"

    @wp.func
    def flowed(F: mat, back: mat, elastic: mat, r: vec4):
        return follow(elastic, F * back * elastic, elastic, r)

    @wp.func
    def still(F: mat, back: mat, elastic: mat, r: vec4):
        return F

    onward = flowed if plastic else still

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        F: wp.array(dtype=mat),
        before: wp.array(dtype=mat),
        elastic: wp.array(dtype=mat),
        theta: wp.array(dtype=real),
        kappa: real,
        s: vec4,
        r: vec4,
        step: real,
        seven: int,
        stress: wp.array(dtype=mat),
        after: wp.array(dtype=mat),
        by_F: slopes,
    ):
        i = wp.tid()
        none = mat()
        back = wp.inverse(before[i])
        P = mat()
        count = int(1)
        if by_F.shape[0] > 0:
            count = seven
        k = int(0)
        m = int(0)
        for n in range(count):  # at F, and along six stretches; one call alone is compiled sooner
            G = F[i]
            if n > 0:
                G += step * _half(k, m, real(1.0)) * F[i]
            now = onward(G, back, elastic[i], r)
            tau, _e = evaluate(now, none, theta, kappa, s, r, 0, real(0.0))
            new = tau * wp.transpose(wp.inverse(G))
            if n == 0:
                P = new
                stress[i] = P
                after[i] = now
            else:
                turn = _half(k, m, real(-1.0)) * P
                _write(by_F, i, 3 * k + m, (new - P) / step + turn)
                _write(by_F, i, 3 * m + k, (new - P) / step - turn)
                m += 1
                if m > 2:
                    k += 1
                    m = k
        if by_F.shape[0] == 0:
            return
        inverse = wp.inverse(F[i])
        for k in range(seven / 2):  # dF = E_kl is a change F^-1_lm along every row k and column m
            A = _read(by_F, i, 3 * k)
            B = _read(by_F, i, 3 * k + 1)
            C = _read(by_F, i, 3 * k + 2)
            for f in range(seven / 2):
                _write(
                    by_F, i, 3 * k + f, inverse[f, 0] * A + inverse[f, 1] * B + inverse[f, 2] * C
                )

    return kernel


@cache
def tangents(law: Law):
    """Kernel: stress and its derivatives by F, see ``weak.tangent``.

    ``nine`` is what it says, an argument since the compiler would unroll loops over a constant.
    """
    evaluate = response(law)

    @wp.kernel(module="unique", enable_backward=False)
    def kernel(
        F: wp.array(dtype=mat),
        L: wp.array(dtype=mat),
        unload: wp.array(dtype=mat),
        pressure: wp.array(dtype=real),
        theta: wp.array(dtype=real),
        kappa: real,
        s: vec4,
        r: vec4,
        step: real,
        speed: real,
        nine: int,
        stress: wp.array(dtype=mat),
        by_F: slopes,
        by_L: slopes,
        elastic_by_F: slopes,
    ):
        i = wp.tid()
        U = wp.identity(n=3, dtype=real)
        if unload.shape[0] > 0:
            U = unload[i]
        p = real(0.0)
        if pressure.shape[0] > 0:
            p = pressure[i]
        tau = mat()
        elastic = mat()
        none = mat()
        count = 1 + nine
        if by_L.shape[0] > 0:
            count += nine
        for n in range(count):  # one call alone, which halves the time to compile
            f = n - 1
            dF = none
            dL = none
            if n > nine:
                f = n - 1 - nine
                dL = _entry(f, speed)
            elif n > 0:
                dF = _entry(f, step)
            here, back = evaluate(
                (F[i] + dF) * U, L[i] + dL, theta, kappa, s, r, pressure.shape[0], p
            )
            if n == 0:
                tau = here
                elastic = back
            elif n > nine:
                _write(by_L, i, f, (here - tau) / speed)
            else:
                _write(by_F, i, f, (here - tau) / step)
                if elastic_by_F.shape[0] > 0:
                    _write(elastic_by_F, i, f, (back - elastic) / step)
        stress[i] = tau

    return kernel


@wp.func
def _entry(f: int, size: real):
    """A matrix with one entry that is not zero."""
    E = mat()
    E[f / 3, f % 3] = size
    return E


@wp.func
def _half(k: int, m: int, sign: real):
    """Half of the sum, or of the difference, of an entry and its transpose."""
    return real(0.5) * (_entry(3 * k + m, real(1.0)) + sign * _entry(3 * m + k, real(1.0)))


@wp.func
def _column(a: mat, n: int):
    return vec3(a[0, n], a[1, n], a[2, n])


@wp.func
def _write(out: slopes, i: int, f: int, D: mat):
    """Derivatives by one entry."""
    for k in range(3):
        for m in range(3):
            out[i, 3 * k + m, f] = D[k, m]


@wp.func
def _read(out: slopes, i: int, f: int):
    D = mat()
    for k in range(3):
        for m in range(3):
            D[k, m] = out[i, 3 * k + m, f]
    return D


@wp.func
def _stretches(by_G: slopes, i: int, G: mat, F: mat, T: mat, tau: mat, axes: wp.vec2i, nine: int):
    """Stretches along traction-free directions and their derivatives by F.

    With G = F diag(s) and S = G^-1 tau G^-T, S_aa = 0 along such a direction a at any F, so that
    sum_b (H_a)_b . F_b ds_b = -sum_l s_l (H_a)_l . dF_l with H_a = dS_aa / dG, index of columns.
    """
    a = axes[0]
    b = wp.max(axes[1], 0)
    s = vec3(real(1.0), real(1.0), real(1.0))
    s[a] = wp.length(_column(G, a)) / wp.length(_column(F, a))
    S = wp.transpose(T) * tau * T
    g = _column(T, a)
    h = _column(T, b)
    Ha = mat()
    Hb = mat()
    for f in range(nine):
        D = _read(by_G, i, f)
        Ha[f / 3, f % 3] = wp.dot(g, D * g) - real(2.0) * g[f / 3] * S[f % 3, a]
        Hb[f / 3, f % 3] = wp.dot(h, D * h) - real(2.0) * h[f / 3] * S[f % 3, b]
    aa = wp.dot(_column(Ha, a), _column(F, a))
    if axes[1] < 0:
        return s, -(real(1.0) / aa) * (Ha * wp.diag(s)), mat()
    s[b] = wp.length(_column(G, b)) / wp.length(_column(F, b))
    ab = wp.dot(_column(Ha, b), _column(F, b))
    ba = wp.dot(_column(Hb, a), _column(F, a))
    bb = wp.dot(_column(Hb, b), _column(F, b))
    Ha = Ha * wp.diag(s)
    Hb = Hb * wp.diag(s)
    share = real(1.0) / (aa * bb - ab * ba)
    return s, share * (ab * Hb - bb * Ha), share * (ba * Ha - aa * Hb)


@wp.func
def _moved(f: int, F: mat, s: vec3, one: mat, two: mat, axes: wp.vec2i):
    """How F diag(s) moves with an entry of F, where s moves by ``one`` and ``two`` along two axes."""
    dG = _entry(f, s[f % 3])
    for k in range(3):
        for m in range(3):
            if m == axes[0]:
                dG[k, m] = dG[k, m] + one[f / 3, f % 3] * F[k, m]
            if m == axes[1]:
                dG[k, m] = dG[k, m] + two[f / 3, f % 3] * F[k, m]
    return dG


@wp.func
def _chain(by_G: slopes, i: int, F: mat, s: vec3, one: mat, two: mat, axes: wp.vec2i, nine: int):
    """Derivatives by F diag(s) become those by F."""
    for e in range(nine):
        a = real(0.0)
        b = real(0.0)
        for k in range(3):
            a += by_G[i, e, 3 * k + axes[0]] * F[k, axes[0]]
            if axes[1] >= 0:
                b += by_G[i, e, 3 * k + axes[1]] * F[k, axes[1]]
        for f in range(nine):
            own = by_G[i, e, f] * s[f % 3]
            by_G[i, e, f] = own + a * one[f / 3, f % 3] + b * two[f / 3, f % 3]


@wp.kernel(module="unique", enable_backward=False)
def paired(
    F: wp.array(dtype=mat),
    seen: wp.array(dtype=mat),
    axes: wp.vec2i,
    material: int,
    nine: int,
    stress: wp.array(dtype=mat),
    by_F: slopes,
    by_L: slopes,
):
    """Derivatives by F become those by ``seen``, and Kirchhoff stresses the first of Piola's."""
    i = wp.tid()
    T = wp.transpose(wp.inverse(F[i]))
    along = vec3(real(1.0), real(1.0), real(1.0))
    one = mat()
    two = mat()
    if seen.shape[0] > 0:
        along, one, two = _stretches(by_F, i, F[i], seen[i], T, stress[i], axes, nine)
        _chain(by_F, i, seen[i], along, one, two, axes, nine)
    if material != 0:
        stress[i] = stress[i] * T
        G = F[i]
        if seen.shape[0] > 0:
            G = seen[i]
        for f in range(nine):
            dG = _moved(f, G, along, one, two, axes)
            _write(by_F, i, f, (_read(by_F, i, f) - stress[i] * wp.transpose(dG)) * T)
            if by_L.shape[0] > 0:
                _write(by_L, i, f, _read(by_L, i, f) * T)
