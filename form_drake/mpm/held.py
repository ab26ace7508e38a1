"""Arrays of a device that the host reads and writes between steps."""

import numpy as np
import warp as wp


class Held:
    """An array of a device; on the CPU the host shares its memory, which is faster than copies.

    Attributes:
        array: for kernels.
    """

    def __init__(self, array: wp.array):
        self.array = array
        first = array.numpy()
        self._like = first.shape, first.dtype
        self._shared = first if array.device.is_cpu else None

    def read(self) -> np.ndarray:
        """The values, a copy."""
        return self.array.numpy() if self._shared is None else self._shared.copy()

    def write(self, value: np.ndarray | float) -> None:
        """Values in its own or a broadcast shape."""
        if self._shared is None:
            shape, dtype = self._like
            self.array.assign(np.ascontiguousarray(np.broadcast_to(value, shape), dtype=dtype))
        else:
            self._shared[...] = value
