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
        self._shared = array.numpy() if array.device.is_cpu else None

    def read(self) -> np.ndarray:
        """The values, a copy."""
        return self.array.numpy() if self._shared is None else self._shared.copy()

    def write(self, value: np.ndarray | float) -> None:
        """Values in its own or a broadcast shape."""
        if self._shared is None:
            own = wp.types.type_scalar_type(self.array.dtype)
            dtype = wp.dtype_to_numpy(own)
            shape = self.array.numpy().shape
            self.array.assign(np.ascontiguousarray(np.broadcast_to(value, shape), dtype=dtype))
        else:
            self._shared[...] = value
