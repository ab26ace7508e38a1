"""Warp kernels that read pictures."""

from functools import cache

import warp as wp

from form_drake.perceive.splines import MARGIN
from form_drake.perceive.warps import SIZE

STEPS = 30  # at most
STILL = 1e-4  # change of the middle or the rim [px], from which a part has settled

six = wp.types.vector(6, wp.float32)
row = wp.types.vector(SIZE, wp.float32)
vec = wp.types.vector(SIZE, wp.float64)


@cache
def sampler() -> wp.Function:
    """Warp function (coefficients, x, y) -> grey value there."""

    @wp.func
    def weights(t: wp.float32):
        s = 1.0 - t
        t2, s2 = t * t, s * s
        return six(
            s2 * s2 * s / 120.0,
            (26.0 - t * (50.0 - t * (20.0 + t * (20.0 - t * (20.0 - 5.0 * t))))) / 120.0,
            (66.0 - t2 * (60.0 - t2 * (30.0 - 10.0 * t))) / 120.0,
            (66.0 - s2 * (60.0 - s2 * (30.0 - 10.0 * s))) / 120.0,
            (26.0 - s * (50.0 - s * (20.0 + s * (20.0 - s * (20.0 - 5.0 * s))))) / 120.0,
            t2 * t2 * t / 120.0,
        )

    @wp.func
    def sample(c: wp.array2d(dtype=wp.float32), x: wp.float64, y: wp.float64):
        left, top = wp.floor(x), wp.floor(y)
        across, down = weights(wp.float32(x - left)), weights(wp.float32(y - top))
        i, j = int(left) - 2, int(top) - 2
        found = float(0.0)
        for m in range(6):
            row = float(0.0)
            for n in range(6):
                row += across[n] * c[j + m, i + n]
            found += down[m] * row
        return found

    return sample


@cache
def stepping():
    """One part until it settles: (settled, likeness), and what is left.

    What is left of a pixel is the other picture's grey value, brought to the first one's brightness and
    contrast, less the first one's.
    """
    sample = sampler()

    @wp.func
    def hessian(w: vec, k: int):
        return wp.mat22d(w[k + 3], w[k + 4], w[k + 4], w[k + 5])

    @wp.func
    def after(w: vec, v: vec):
        """d -> w(v(d)) to second order."""
        out, one = vec(), wp.float64(1.0)
        shift = wp.vec2d(v[0], v[6])
        turn = wp.mat22d(one + v[1], v[2], v[7], one + v[8])
        for n in range(2):
            k = 6 * n
            bend = hessian(w, k)
            slope = wp.vec2d(w[k + 1], w[k + 2])
            there = slope + bend * shift
            line = wp.transpose(turn) * there
            curve = wp.transpose(turn) * bend * turn
            curve += there[0] * hessian(v, 0) + there[1] * hessian(v, 6)
            out[k] = v[k] + w[k] + wp.float64(0.5) * wp.dot(slope + there, shift)
            out[k + 1] = v[k + 1] + line[0]
            out[k + 2] = v[k + 2] + line[1]
            out[k + 3] = v[k + 3] + curve[0, 0]
            out[k + 4] = v[k + 4] + curve[0, 1]
            out[k + 5] = v[k + 5] + curve[1, 1]
        return out

    @wp.func
    def place(w: vec, k: int, x: wp.float64, y: wp.float64):
        half = wp.float64(0.5)
        line = w[k] + w[k + 1] * x + w[k + 2] * y
        return line + half * w[k + 3] * x * x + w[k + 4] * x * y + half * w[k + 5] * y * y

    @wp.kernel(module="unique", enable_backward=False)
    def step(
        picture: wp.array2d(dtype=wp.float32),
        middle: wp.array(dtype=wp.vec2d),
        grid: wp.array(dtype=wp.vec2d),
        values: wp.array2d(dtype=wp.float32),
        mean: wp.array(dtype=wp.float32),
        steps: wp.array2d(dtype=row),
        half: wp.float64,
        warps: wp.array(dtype=vec),
        told: wp.array(dtype=wp.vec2d),
        left: wp.array2d(dtype=wp.float32),
    ):
        p = wp.tid()
        w, settled = vec() + warps[p], wp.float64(0.0)
        least = wp.float64(MARGIN)
        right = wp.float64(picture.shape[1] - 1) - least
        low = wp.float64(picture.shape[0] - 1) - least
        pixels = values.shape[1]
        likeness, contrast, size = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
        for n in range(pixels):
            size += wp.float64(values[p, n]) * wp.float64(values[p, n])
        average = wp.float64(0.0)
        for _ in range(STEPS):
            change, total = vec(), wp.float64(0.0)
            squares, common = wp.float64(0.0), wp.float64(0.0)
            inside = int(1)
            for n in range(pixels):
                d = grid[n]
                x = middle[p][0] + d[0] + place(w, 0, d[0], d[1])
                y = middle[p][1] + d[1] + place(w, 6, d[0], d[1])
                if x < least or y < least or x > right or y > low:
                    inside = int(0)
                    break
                g = sample(picture, x, y) - mean[p]
                left[p, n] = g
                change += vec(g * steps[p, n])
                total += wp.float64(g)
                squares += wp.float64(g) * wp.float64(g)
                common += wp.float64(g) * wp.float64(values[p, n])
            average = total / wp.float64(pixels)
            contrast = squares - total * total / wp.float64(pixels)
            if inside == 0 or contrast <= wp.float64(0.0):
                break
            likeness = common / wp.sqrt(contrast * size)
            change *= -wp.sqrt(size / contrast)
            w = after(w, change)
            far = wp.abs(change[0]) + wp.abs(change[6])
            for k in range(1, 6):
                reach = half
                if k > 2:
                    reach = half * half
                far += reach * (wp.abs(change[k]) + wp.abs(change[6 + k]))
            if far < wp.float64(STILL):
                settled = wp.float64(1.0)
                break
        warps[p] = w
        told[p] = wp.vec2d(settled, likeness)
        if settled > wp.float64(0.0):
            gain = wp.float32(likeness * wp.sqrt(size / contrast))
            for n in range(pixels):
                left[p, n] = gain * (left[p, n] - wp.float32(average)) - values[p, n]

    return step


@cache
def pixels():
    """Kernel that paints a picture: the mean of rays through each pixel."""

    @wp.func
    def texel(texture: wp.array2d(dtype=wp.float32), u: float, v: float):
        column = wp.clamp(u, 0.0, float(texture.shape[1] - 1))
        line = wp.clamp(v, 0.0, float(texture.shape[0] - 1))
        i = wp.min(int(column), texture.shape[1] - 2)
        j = wp.min(int(line), texture.shape[0] - 2)
        a, b = column - float(i), line - float(j)
        upper = (1.0 - a) * texture[j, i] + a * texture[j, i + 1]
        lower = (1.0 - a) * texture[j + 1, i] + a * texture[j + 1, i + 1]
        return (1.0 - b) * upper + b * lower

    @wp.kernel(module="unique", enable_backward=False)
    def paint(
        mesh: wp.uint64,
        origin: wp.vec3,
        ray: wp.array2d(dtype=wp.vec3),
        across: wp.array2d(dtype=wp.vec3),
        down: wp.array2d(dtype=wp.vec3),
        uv: wp.array(dtype=wp.vec2),
        texture: wp.array2d(dtype=wp.float32),
        plain: wp.array(dtype=wp.float32),
        count: int,
        ground: float,
        seen: wp.array2d(dtype=wp.float32),
    ):
        j, i = wp.tid()
        d = ray[j, i]
        hit = wp.mesh_query_ray(mesh, origin, d, 1.0e6)
        if not hit.result:
            seen[j, i] = ground
            return
        face = hit.face
        if not wp.isnan(plain[face]):
            seen[j, i] = plain[face]
            return
        p = wp.mesh_eval_position(mesh, face, 1.0, 0.0)
        e = wp.mesh_eval_position(mesh, face, 0.0, 1.0) - p
        f = wp.mesh_eval_position(mesh, face, 0.0, 0.0) - p
        n = wp.cross(e, f)
        square = wp.dot(n, n)
        height = wp.dot(p - origin, n)
        base, one, other = uv[3 * face], uv[3 * face + 1], uv[3 * face + 2]
        total = float(0.0)
        for a in range(count):
            for b in range(count):
                x = (float(a) + 0.5) / float(count) - 0.5
                y = (float(b) + 0.5) / float(count) - 0.5
                way = d + x * across[j, i] + y * down[j, i]
                q = origin + way * (height / wp.dot(way, n)) - p
                s = wp.dot(wp.cross(q, f), n) / square
                t = wp.dot(wp.cross(e, q), n) / square
                at = base + s * (one - base) + t * (other - base)
                total += texel(texture, at[0], at[1])
        seen[j, i] = total / float(count * count)

    return paint
