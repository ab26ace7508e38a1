"""Transfer between particles and a grid over their rest shape on the CPU, eight particles at a time.

Over the rest shape particles keep their nodes and weights. So those that share their nodes are dealt with
together, each in a lane of Clang's vector types, and what the nodes weigh is found once. The sums are those
of ``transfer`` (``mls``, ``total``), in single precision.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
import warp as wp

from form_drake.basis import splines
from form_drake.laws.kernels import types

LANES = 8

_FRAME = """
#if defined(__clang__) && !defined(__CUDA_ARCH__)
#define EACH(n, count) _Pragma("clang loop unroll(full)") for (int n = 0; n < count; ++n)
    typedef float lanes __attribute__((ext_vector_type(8)));
    typedef float quad __attribute__((ext_vector_type(4)));
    const int* own = member.data + 8 * group;
    const float* told = table.data + 8 * 14 * group;
    auto row = [&](int k) { lanes r; __builtin_memcpy(&r, told + 8 * k, sizeof r); return r; };
    auto load = [&](const auto& a, int width, int k) {
        const float* from = (const float*)a.data + k;
        lanes r;
        EACH(l, 8) r[l] = from[width * own[l]];
        return r;
    };
    auto fma = [](lanes a, lanes b, lanes c) { return __builtin_elementwise_fma(a, b, c); };
    auto inverse = [](const lanes (&T)[9], lanes (&out)[9]) {
        EACH(a, 3) EACH(b, 3) {
            const int i = (b + 1) % 3, j = (b + 2) % 3, k = (a + 1) % 3, l = (a + 2) % 3;
            out[3 * a + b] = T[3 * i + k] * T[3 * j + l] - T[3 * i + l] * T[3 * j + k];
        }
        const lanes one = 1.0f / (T[0] * out[0] + T[1] * out[3] + T[2] * out[6]);
        EACH(n, 9) out[n] *= one;
    };
    // row a of one matrix times what lies at 0, step and 2 step
    auto product = [](const lanes* a, const lanes* b, int step) {
        return a[0] * b[0] + a[1] * b[step] + a[2] * b[2 * step];
    };
    const int layer = nodes[1] * nodes[2], line = nodes[2];
    lanes w[9], d[9]; // splines by axis and node, and these times how far the node is
    EACH(n, 9) {
        w[n] = row(n);
        d[n] = w[n] * ((n % 3) - row(9 + n / 3));
    }
    BODY
#undef EACH
#endif
"""

_SCATTER = """
    const lanes m = share * row(12), flux = 4.0f / (dx * dx) * clock.data[0].c[0] * row(13);
    lanes T[9], back[9], tau[9], U[3], A[9];
    EACH(n, 9) {
        T[n] = load(whole, 9, n);
        tau[n] = load(stress, 9, n);
    }
    inverse(T, back);
    EACH(a, 3) U[a] = m * load(v, 3, a);
    EACH(a, 3) EACH(b, 3) {
        const lanes pulled = product(tau + 3 * a, back + 3 * b, 1);
        A[3 * a + b] = dx * (m * load(C, 9, 3 * a + b) - flux * pulled);
    }
    float* node = (float*)(grid.data + first.data[group]);
    EACH(i, 3) {
        lanes P[3], Q[3], R[3];
        EACH(a, 3) {
            P[a] = fma(d[i], A[3 * a], w[i] * U[a]);
            Q[a] = w[i] * A[3 * a + 1];
            R[a] = w[i] * A[3 * a + 2];
        }
        EACH(j, 3) {
            lanes p[3], r[3];
            EACH(a, 3) {
                p[a] = fma(d[3 + j], Q[a], w[3 + j] * P[a]);
                r[a] = w[3 + j] * R[a];
            }
            EACH(k, 3) {
                quad half[3];
                EACH(a, 3) {
                    const lanes all = fma(d[6 + k], r[a], w[6 + k] * p[a]);
                    half[a] = all.lo + all.hi;
                }
                const quad none = 0.0f; // of the mass
                const quad xy = __builtin_shufflevector(half[0], half[1], 0, 4, 1, 5)
                    + __builtin_shufflevector(half[0], half[1], 2, 6, 3, 7);
                const quad z = __builtin_shufflevector(half[2], none, 0, 4, 1, 5)
                    + __builtin_shufflevector(half[2], none, 2, 6, 3, 7);
                float* at = node + 4 * (i * layer + j * line + k);
                quad sum;
                __builtin_memcpy(&sum, at, sizeof sum);
                sum += __builtin_shufflevector(xy, z, 0, 1, 4, 5)
                    + __builtin_shufflevector(xy, z, 2, 3, 6, 7);
                __builtin_memcpy(at, &sum, sizeof sum);
            }
        }
    }
"""

_GATHER = """
    const float dt = clock.data[0].c[0];
    const float* node = (const float*)(grid.data + first.data[group]);
    lanes u[3] = {0, 0, 0}, rate[9] = {0, 0, 0, 0, 0, 0, 0, 0, 0};
    EACH(i, 3) {
        lanes p[3] = {0, 0, 0}, q[3] = {0, 0, 0}, r[3] = {0, 0, 0};
        EACH(j, 3) {
            const float* g = node + 4 * (i * layer + j * line);
            EACH(a, 3) {
                const lanes g0 = g[a], g1 = g[4 + a], g2 = g[8 + a];
                const lanes h = fma(w[8], g2, fma(w[7], g1, w[6] * g0));
                const lanes s = fma(d[8], g2, fma(d[7], g1, d[6] * g0));
                p[a] = fma(w[3 + j], h, p[a]);
                q[a] = fma(d[3 + j], h, q[a]);
                r[a] = fma(w[3 + j], s, r[a]);
            }
        }
        EACH(a, 3) {
            u[a] = fma(w[i], p[a], u[a]);
            rate[3 * a] = fma(d[i], p[a], rate[3 * a]);
            rate[3 * a + 1] = fma(w[i], q[a], rate[3 * a + 1]);
            rate[3 * a + 2] = fma(w[i], r[a], rate[3 * a + 2]);
        }
    }
    lanes T[9], back[9], F[9], l[9], now[9], low_F[9];
    double x[8][3]; // in single precision, what is slow would be rounded away
    EACH(n, 9) {
        rate[n] *= 4.0f / dx;
        T[n] = load(whole, 9, n);
        F[n] = load(elastic, 9, n);
        low_F[n] = load(lost, 9, n);
    }
    inverse(T, back);
    EACH(a, 3) EACH(b, 3) l[3 * a + b] = product(rate + 3 * a, back + b, 3);
    EACH(a, 3) EACH(b, 3) {
        const int n = 3 * a + b;
        const lanes more = dt * product(l + 3 * a, F + b, 3) + low_F[n];
        now[n] = F[n] + more;
        low_F[n] = more - (now[n] - F[n]);
    }
    EACH(n, 9) T[n] += dt * rate[n];
    EACH(k, 8) EACH(a, 3) x[k][a] = ((double*)(place.data + own[k]))[a] + dt * u[a][k];
    EACH(k, 8) {
        const int p = own[k];
        EACH(n, 9) {
            ((float*)(whole.data + p))[n] = T[n][k];
            ((float*)(elastic.data + p))[n] = now[n][k];
            ((float*)(lost.data + p))[n] = low_F[n][k];
            ((float*)(L.data + p))[n] = l[n][k];
            ((float*)(C.data + p))[n] = rate[n][k];
        }
        EACH(a, 3) ((float*)(v.data + p))[a] = u[a][k];
        bool inside = true;
        EACH(a, 3) inside = inside && x[k][a] >= low[a] && x[k][a] <= high[a];
        if (inside) {
            EACH(a, 3) ((double*)(place.data + p))[a] = x[k][a];
        } else if (fault.data[0] < 0) {
            fault.data[0] = p;
            fault.data[1] = steps.data[0];
        }
    }
"""


@dataclass(frozen=True)
class Eights:
    """Particles by the nodes that they share, as arrays on the CPU.

    Attributes:
        first: flat index of the first node of each group, shape [groups].
        member: particles, the last one repeated to fill a group, shape [groups, 8].
        table: splines by axis and node, places from the first node in cells, masses [kg] and volumes
            [m^3], these two zero where a particle is repeated; shape [groups, 14, 8].
        mass: of the nodes [kg], as the fourth component, shape [nodes].
    """

    first: wp.array
    member: wp.array
    table: wp.array
    mass: wp.array

    @classmethod
    def of(
        cls, x: np.ndarray, mass: np.ndarray, volume: np.ndarray, dx: float, nodes: tuple[int, ...]
    ) -> "Eights":
        """Of particles at rest at ``x`` [m] in the grid's frame, shape [particles, 3]."""
        base = np.clip(np.floor(x / dx - 0.5).astype(int), 0, np.array(nodes) - 3)
        flat = np.ravel_multi_index(tuple(base.T), nodes)
        order = np.argsort(flat, kind="stable")
        groups = [
            shared[n : n + LANES]
            for shared in np.split(order, np.flatnonzero(np.diff(flat[order])) + 1)
            for n in range(0, len(shared), LANES)
        ]
        member = np.array([np.pad(own, (0, LANES - len(own)), mode="edge") for own in groups])
        once = np.arange(LANES) < np.array([[len(own)] for own in groups])
        f = x / dx - base
        w = splines(f)
        own = [w.reshape(-1, 9), f, np.stack([mass, volume], axis=1)]
        table = np.concatenate(own, axis=1)[member].swapaxes(1, 2)
        table[:, 12:] *= once[:, None]
        weight = np.zeros((*nodes, 4))
        share = np.einsum("na,nb,nc->nabc", *w.swapaxes(0, 1)) * mass[:, None, None, None]
        for a, b, c in np.ndindex(3, 3, 3):
            np.add.at(
                weight, (base[:, 0] + a, base[:, 1] + b, base[:, 2] + c, 3), share[:, a, b, c]
            )
        t = types("float32")
        return cls(
            wp.array(flat[member[:, 0]].astype(np.int32), dtype=int, device="cpu"),
            wp.array(member.ravel().astype(np.int32), dtype=int, device="cpu"),
            wp.array(table.ravel().astype(np.float32), dtype=t.real, device="cpu"),
            wp.array(weight.reshape(-1, 4).astype(np.float32), dtype=t.vec4, device="cpu"),
        )

    def scatter(self, grid: wp.array, v, C, tau, T, share, clock, dx, nodes) -> None:
        """Launch what gives nodes, beside their mass, a share of momentum and the impulses of tau."""
        inputs = [self.first, self.member, self.table, grid, v, C, tau, T, share, clock, dx, nodes]
        wp.launch(_kernels()[0], dim=len(self.first), inputs=inputs, device="cpu")

    def gather(self, grid: wp.array, *inputs) -> None:
        """Launch what moves the particles with the grid."""
        inputs = [self.first, self.member, self.table, grid, *inputs]
        wp.launch(_kernels()[1], dim=len(self.first), inputs=inputs, device="cpu")


@cache
def _kernels():
    """Kernels that scatter and gather, a thread for a group."""
    t = types("float32")
    real, vec3, vec4, mat = t.real, t.vec3, t.vec4, t.mat

    @wp.func_native(_FRAME.replace("BODY", _SCATTER))
    def scatter(
        group: int,
        first: wp.array(dtype=int),
        member: wp.array(dtype=int),
        table: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        stress: wp.array(dtype=mat),
        whole: wp.array(dtype=mat),
        share: real,
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
    ): ...

    @wp.func_native(_FRAME.replace("BODY", _GATHER))
    def gather(
        group: int,
        first: wp.array(dtype=int),
        member: wp.array(dtype=int),
        table: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
        low: vec3,
        high: vec3,
        place: wp.array(dtype=wp.vec3d),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        L: wp.array(dtype=mat),
        elastic: wp.array(dtype=mat),
        lost: wp.array(dtype=mat),
        whole: wp.array(dtype=mat),
        fault: wp.array(dtype=int),
        steps: wp.array(dtype=int),
    ): ...

    @wp.kernel(module="unique", enable_backward=False)
    def scattering(
        first: wp.array(dtype=int),
        member: wp.array(dtype=int),
        table: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        tau: wp.array(dtype=mat),
        T: wp.array(dtype=mat),
        share: real,
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
    ):
        scatter(wp.tid(), first, member, table, grid, v, C, tau, T, share, clock, dx, nodes)

    @wp.kernel(module="unique", enable_backward=False)
    def gathering(
        first: wp.array(dtype=int),
        member: wp.array(dtype=int),
        table: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
        low: vec3,
        high: vec3,
        x: wp.array(dtype=wp.vec3d),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        L: wp.array(dtype=mat),
        F: wp.array(dtype=mat),
        lost: wp.array(dtype=mat),
        T: wp.array(dtype=mat),
        fault: wp.array(dtype=int),
        steps: wp.array(dtype=int),
    ):
        p = wp.tid()
        gather(
            p,
            first,
            member,
            table,
            grid,
            clock,
            dx,
            nodes,
            low,
            high,
            x,
            v,
            C,
            L,
            F,
            lost,
            T,
            fault,
            steps,
        )

    return scattering, gathering
