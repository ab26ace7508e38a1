"""Arithmetic on the four lanes of a grid node (a vector and the mass), as Warp functions.

On the CPU Warp's own ``vec4`` operations are loops over the components, of which LLVM makes vector
instructions only now and then; with Clang's vector types each of these is one or two instructions.
"""

from functools import cache

import warp as wp

from form_drake.laws.kernels import types

_SNIPPET = """
#if defined(__clang__) && !defined(__CUDA_ARCH__)
    typedef {scalar} lanes __attribute__((ext_vector_type(4)));
    lanes {operands};
    {loads}
    lanes sum = {formula};
    wp::vec_t<4, {scalar}> out;
    __builtin_memcpy(&out, &sum, sizeof(lanes));
    return out;
#else
    return {plain};
#endif
"""


def _snippet(precision: str, plain: str, operands: str) -> str:
    """C++ for ``plain``, a sum of products, with every vector operand held in lanes."""
    formula = plain
    for name in operands:
        formula = formula.replace(name, f"{name}_lanes")
    return _SNIPPET.format(
        scalar={"float32": "float", "float64": "double"}[precision],
        operands=", ".join(f"{name}_lanes" for name in operands),
        loads="".join(f"__builtin_memcpy(&{n}_lanes, &{n}, sizeof(lanes));" for n in operands),
        formula=formula,
        plain=plain,
    )


@cache
def lanes(precision: str):
    """Warp functions scaled(s, a) = s a and axpy(s, a, b) = s a + b."""
    t = types(precision)

    @wp.func_native(_snippet(precision, "s * a", "a"))
    def scaled(s: t.real, a: t.vec4) -> t.vec4: ...

    @wp.func_native(_snippet(precision, "s * a + b", "ab"))
    def axpy(s: t.real, a: t.vec4, b: t.vec4) -> t.vec4: ...

    return scaled, axpy


@cache
def sums(precision: str):
    """Warp functions over three nodes of an axis with weights w, of which row = node.

    ``blend(w, axis, a, b, c)`` = w_0 a + w_1 b + w_2 c; ``moment(w, axis, b, c)`` = w_1 b + 2 w_2 c.
    """
    t = types(precision)
    mat, vec4 = t.mat, t.vec4
    scaled, axpy = lanes(precision)
    two = wp.constant(t.real(2.0))

    @wp.func
    def blend(w: mat, axis: int, a: vec4, b: vec4, c: vec4):
        return axpy(w[2, axis], c, axpy(w[1, axis], b, scaled(w[0, axis], a)))

    @wp.func
    def moment(w: mat, axis: int, b: vec4, c: vec4):
        return axpy(two * w[2, axis], c, scaled(w[1, axis], b))

    return blend, moment


@cache
def plane(precision: str):
    """Warp function (grid, first node, nodes per row, w, g) that sums nine nodes of the stencil.

    Returns the sum, its first moments along the second and third axis, and its derivatives along
    these axes.
    """
    t = types(precision)
    mat, vec4 = t.mat, t.vec4
    blend, moment = sums(precision)

    @wp.func
    def function(grid: wp.array(dtype=vec4), n: int, row: int, w: mat, g: mat):
        h0 = blend(w, 2, grid[n], grid[n + 1], grid[n + 2])
        m0 = moment(w, 2, grid[n + 1], grid[n + 2])
        s0 = blend(g, 2, grid[n], grid[n + 1], grid[n + 2])
        n1 = n + row
        h1 = blend(w, 2, grid[n1], grid[n1 + 1], grid[n1 + 2])
        m1 = moment(w, 2, grid[n1 + 1], grid[n1 + 2])
        s1 = blend(g, 2, grid[n1], grid[n1 + 1], grid[n1 + 2])
        n2 = n1 + row
        h2 = blend(w, 2, grid[n2], grid[n2 + 1], grid[n2 + 2])
        m2 = moment(w, 2, grid[n2 + 1], grid[n2 + 2])
        s2 = blend(g, 2, grid[n2], grid[n2 + 1], grid[n2 + 2])
        moment1, moment2 = moment(w, 1, h1, h2), blend(w, 1, m0, m1, m2)
        slope1, slope2 = blend(g, 1, h0, h1, h2), blend(w, 1, s0, s1, s2)
        return blend(w, 1, h0, h1, h2), moment1, moment2, slope1, slope2

    return function
