"""Kernels of ``pencils``, a thread for eight particles of a line: C++ in Clang's vector types."""

from functools import cache

import warp as wp

from form_drake.laws.kernels import types

_FRAME = """
#if defined(__clang__) && !defined(__CUDA_ARCH__)
#define EACH(n, count) _Pragma("clang loop unroll(full)") for (int n = 0; n < count; ++n)
#define MIX __builtin_shufflevector
    typedef float lanes __attribute__((ext_vector_type(8)));
    typedef float quad __attribute__((ext_vector_type(4)));
    const int *told = index.data + 11 * pencil, *own = told + 3, pairs = told[1];
    const float *head = table.data + 28 * pencil, *along = pattern.data + told[2];
    const int stride[3] = {4 * nodes[1] * nodes[2], 4 * nodes[2], 4};
    const int first = (axis + 1) % 3, second = (axis + 2) % 3; // axes across the pencil
    const int step = stride[axis], wide = stride[first], deep = stride[second];
    auto load = [](const float* from) { lanes r; __builtin_memcpy(&r, from, sizeof r); return r; };
    auto fma = [](lanes a, lanes b, lanes c) { return __builtin_elementwise_fma(a, b, c); };
    auto turned = [](const lanes* r, lanes* out) { // rows to columns
        lanes t[8], u[8];
        EACH(n, 4) {
            t[2 * n] = MIX(r[2 * n], r[2 * n + 1], 0, 8, 1, 9, 4, 12, 5, 13);
            t[2 * n + 1] = MIX(r[2 * n], r[2 * n + 1], 2, 10, 3, 11, 6, 14, 7, 15);
        }
        EACH(n, 2) EACH(k, 2) {
            u[4 * n + 2 * k] = MIX(t[4 * n + k], t[4 * n + k + 2], 0, 1, 8, 9, 4, 5, 12, 13);
            u[4 * n + 2 * k + 1] = MIX(t[4 * n + k], t[4 * n + k + 2], 2, 3, 10, 11, 6, 7, 14, 15);
        }
        EACH(n, 4) {
            out[n] = MIX(u[n], u[n + 4], 0, 1, 2, 3, 8, 9, 10, 11);
            out[n + 4] = MIX(u[n], u[n + 4], 4, 5, 6, 7, 12, 13, 14, 15);
        }
    };
    auto read = [&](const auto& a, lanes (&out)[9]) {
        const float* from = (const float*)a.data;
        lanes r[8];
        EACH(l, 8) r[l] = load(from + 9 * own[l]);
        turned(r, out);
        EACH(l, 8) out[8][l] = from[9 * own[l] + 8];
    };
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
    // momenta or velocities of two nodes of the line of nodes at a place across
    auto two = [&](const float* at) {
        quad a, b;
        __builtin_memcpy(&a, at, sizeof a);
        __builtin_memcpy(&b, at + step, sizeof b);
        return MIX(a, b, 0, 1, 2, 3, 4, 5, 6, 7);
    };
    BODY
#undef MIX
#undef EACH
#endif
"""

_SCATTER = """
    const lanes m = share.data[0] * load(head + 12), flux = 4.0f / (dx * dx) * clock.data[0].c[0] * load(head + 20);
    lanes T[9], back[9], tau[9], old[9], A[12];
    read(whole, T);
    read(stress, tau);
    read(C, old);
    inverse(T, back);
    EACH(a, 3) EACH(b, 3) {
        const lanes pulled = product(tau + 3 * a, back + 3 * b, 1);
        A[3 * b + a] = dx * (m * old[3 * a + b] - flux * pulled);
    }
    EACH(a, 3) EACH(l, 8) A[9 + a][l] = ((const float*)v.data)[3 * own[l] + a];
    EACH(a, 3) A[9 + a] *= m;
    lanes quads[4][4]; // columns of A and the momentum, by particle
    EACH(c, 4) {
        const lanes x = A[3 * c], y = A[3 * c + 1], z = A[3 * c + 2], none = 0.0f;
        const lanes xy = MIX(x, y, 0, 8, 1, 9, 4, 12, 5, 13), z0 = MIX(z, none, 0, 8, 1, 9, 4, 12, 5, 13);
        const lanes yx = MIX(x, y, 2, 10, 3, 11, 6, 14, 7, 15), z1 = MIX(z, none, 2, 10, 3, 11, 6, 14, 7, 15);
        quads[c][0] = MIX(xy, z0, 0, 1, 8, 9, 4, 5, 12, 13);
        quads[c][1] = MIX(xy, z0, 2, 3, 10, 11, 6, 7, 14, 15);
        quads[c][2] = MIX(yx, z1, 0, 1, 8, 9, 4, 5, 12, 13);
        quads[c][3] = MIX(yx, z1, 2, 3, 10, 11, 6, 7, 14, 15);
    }
    float* node = (float*)grid.data + 4 * told[0];
    for (int pair = 0; pair < pairs; ++pair) {
        lanes U = 0.0f, P = 0.0f, Q = 0.0f, R = 0.0f;
        EACH(s, 8) {
            const float* at = along + 16 * (8 * pair + s);
            const lanes w = load(at), d = load(at + 8);
            lanes part[4];
            EACH(c, 4) {
                const lanes both = quads[c == 3 ? 3 : (c == 0 ? axis : (c == 1 ? first : second))][s / 2];
                part[c] = s % 2 ? MIX(both, both, 4, 5, 6, 7, 4, 5, 6, 7) : MIX(both, both, 0, 1, 2, 3, 0, 1, 2, 3);
            }
            U = fma(w, part[3], U);
            P = fma(d, part[0], P);
            Q = fma(w, part[1], Q);
            R = fma(w, part[2], R);
        }
        U += P;
        EACH(i, 3) {
            const lanes at_i = head[i] * U + head[3 + i] * Q, r = head[i] * R;
            EACH(j, 3) {
                float* at = node + 2 * step * pair + i * wide + j * deep;
                const lanes sum = two(at) + (head[6 + j] * at_i + head[9 + j] * r);
                const quad a = sum.lo, b = sum.hi;
                __builtin_memcpy(at, &a, sizeof a);
                __builtin_memcpy(at + step, &b, sizeof b);
            }
        }
    }
"""

_GATHER = """
    typedef double places __attribute__((ext_vector_type(8)));
    const float dt = clock.data[0].c[0];
    const float* node = (const float*)grid.data + 4 * told[0];
    float line[8][12]; // of nodes: sums across the pencil, and their first moments along the axes there
    for (int pair = 0; pair < pairs; ++pair) {
        lanes U = 0.0f, Q = 0.0f, R = 0.0f;
        EACH(i, 3) {
            lanes p = 0.0f, q = 0.0f;
            EACH(j, 3) {
                const lanes g = two(node + 2 * step * pair + i * wide + j * deep);
                p = fma(head[6 + j], g, p);
                q = fma(head[9 + j], g, q);
            }
            U = fma(head[i], p, U);
            Q = fma(head[3 + i], p, Q);
            R = fma(head[i], q, R);
        }
        const lanes all[3] = {U, Q, R};
        EACH(c, 3) {
            const quad a = all[c].lo, b = all[c].hi;
            __builtin_memcpy(line[2 * pair] + 4 * c, &a, sizeof a);
            __builtin_memcpy(line[2 * pair + 1] + 4 * c, &b, sizeof b);
        }
    }
    lanes u[3] = {0, 0, 0}, by[3][3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    const float* own_weights = along + 128 * pairs;
    for (int k = 0; k < 2 * pairs; ++k) {
        const lanes w = load(own_weights + 16 * k), d = load(own_weights + 16 * k + 8);
        EACH(a, 3) {
            u[a] = fma(w, line[k][a], u[a]);
            by[0][a] = fma(d, line[k][a], by[0][a]);
            by[1][a] = fma(w, line[k][4 + a], by[1][a]);
            by[2][a] = fma(w, line[k][8 + a], by[2][a]);
        }
    }
    lanes rate[9], T[9], back[9], F[9], l[9], now[9], low_F[9];
    EACH(c, 3) {
        const int b = (c - axis + 3) % 3;
        EACH(a, 3) rate[3 * a + c] = 4.0f / dx * by[b][a];
    }
    read(whole, T);
    read(elastic, F);
    read(lost, low_F);
    inverse(T, back);
    EACH(a, 3) EACH(b, 3) l[3 * a + b] = product(rate + 3 * a, back + b, 3);
    EACH(a, 3) EACH(b, 3) {
        const int n = 3 * a + b;
        const lanes more = dt * product(l + 3 * a, F + b, 3) + low_F[n];
        now[n] = F[n] + more;
        low_F[n] = more - (now[n] - F[n]);
    }
    EACH(n, 9) T[n] += dt * rate[n];
    auto write = [&](const auto& a, const lanes (&from)[9]) {
        float* to = (float*)a.data;
        lanes r[8];
        turned(from, r);
        EACH(k, 8) __builtin_memcpy(to + 9 * own[k], &r[k], sizeof r[k]);
        EACH(k, 8) to[9 * own[k] + 8] = from[8][k];
    };
    write(whole, T);
    write(elastic, now);
    write(lost, low_F);
    write(L, l);
    write(C, rate);
    // in single precision, what is slow would be rounded away
    double* x = (double*)place.data;
    places to[3];
    decltype(to[0] != to[0]) out = 0;
    EACH(a, 3) {
        EACH(k, 8) to[a][k] = x[3 * own[k] + a];
        to[a] += __builtin_convertvector(dt * u[a], places);
        out |= !(to[a] >= (double)low[a] && to[a] <= (double)high[a]);
        EACH(k, 8) ((float*)v.data)[3 * own[k] + a] = u[a][k];
    }
    EACH(k, 8) {
        if (!out[k]) {
            EACH(a, 3) x[3 * own[k] + a] = to[a][k];
        } else if (fault.data[0] < 0) {
            fault.data[0] = own[k];
            fault.data[1] = steps.data[0];
        }
    }
"""


@cache
def kernels():
    """Kernels that scatter and gather, a thread for a pencil."""
    t = types("float32")
    real, vec3, vec4, mat = t.real, t.vec3, t.vec4, t.mat

    @wp.func_native(_FRAME.replace("BODY", _SCATTER))
    def scatter(
        pencil: int,
        axis: int,
        index: wp.array(dtype=int),
        table: wp.array(dtype=real),
        pattern: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        stress: wp.array(dtype=mat),
        whole: wp.array(dtype=mat),
        share: wp.array(dtype=real),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
    ): ...

    @wp.func_native(_FRAME.replace("BODY", _GATHER))
    def gather(
        pencil: int,
        axis: int,
        index: wp.array(dtype=int),
        table: wp.array(dtype=real),
        pattern: wp.array(dtype=real),
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
        axis: int,
        index: wp.array(dtype=int),
        table: wp.array(dtype=real),
        pattern: wp.array(dtype=real),
        grid: wp.array(dtype=vec4),
        v: wp.array(dtype=vec3),
        C: wp.array(dtype=mat),
        tau: wp.array(dtype=mat),
        T: wp.array(dtype=mat),
        share: wp.array(dtype=real),
        clock: wp.array(dtype=vec4),
        dx: real,
        nodes: wp.vec3i,
    ):
        scatter(wp.tid(), axis, index, table, pattern, grid, v, C, tau, T, share, clock, dx, nodes)

    @wp.kernel(module="unique", enable_backward=False)
    def gathering(
        axis: int,
        index: wp.array(dtype=int),
        table: wp.array(dtype=real),
        pattern: wp.array(dtype=real),
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
            axis,
            index,
            table,
            pattern,
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
