"""Kernels build for a GPU where there is none: what the compiler of GPUs refuses is seen before one is."""

import pytest
import warp as wp

from form_drake.laws import LAWS
from form_drake.laws.kernels import update
from form_drake.mpm.grid import keep
from form_drake.mpm.plates import constrain
from form_drake.mpm.touch import contact
from form_drake.mpm.transfer import g2p, p2g

KERNELS = {
    "p2g": lambda: p2g("mls", "float32"),
    "g2p": lambda: g2p("mls", "float32", True),
    "keep": lambda: keep("float32"),
    "constrain": lambda: constrain("float32"),
    "contact": lambda: contact("float32", True),
    "update": lambda: update(LAWS["von-mises"], "series", "float32"),
}


@pytest.mark.parametrize("name", KERNELS)
def test_a_kernel_builds_for_a_gpu(name, tmp_path):
    (made,) = wp.compile_aot_module(KERNELS[name]().module, arch=90, module_dir=tmp_path)
    assert made.suffix in (".cubin", ".ptx") and made.stat().st_size > 1000
