"""How a motion was stepped: the grid, time step, transfer and walls of a material point solver."""

import math
from dataclasses import dataclass, field
from numbers import Integral, Real
from typing import Literal

Gradient = Literal["exact", "mls"]
WallKind = Literal["separate", "slip", "stick"]

GRADIENTS = ("exact", "mls")
WALL_KINDS = ("separate", "slip", "stick")


def _finite(*values: object) -> bool:
    return all(isinstance(v, Real) and not isinstance(v, bool) and math.isfinite(v) for v in values)


def _whole(*values: object) -> bool:
    return all(isinstance(v, Integral) and not isinstance(v, bool) for v in values)


@dataclass(frozen=True)
class Wall:
    """A plane normal to a grid axis.

    Attributes:
        axis: 0, 1 or 2.
        side: -1 for a wall below the material, +1 above.
        position: coordinate of the plane along the axis [m].
        kind: ``separate`` lets go but not pass and lies on grid nodes, at a whole multiple of
            dx; ``slip`` and ``stick`` hold the plane itself, wherever it lies between nodes.
    """

    axis: int
    side: int
    position: float
    kind: WallKind = "separate"

    def __post_init__(self) -> None:
        known = self.axis in (0, 1, 2) and self.side in (-1, 1)
        if not known or not _whole(self.axis, self.side):
            raise ValueError(
                f"wall axis {self.axis}, side {self.side}: allowed are axes 0, 1, 2 and sides -1, 1"
            )
        if self.kind not in WALL_KINDS:
            raise ValueError(f"wall kind {self.kind!r}: choose one of {', '.join(WALL_KINDS)}")
        if not _finite(self.position):
            raise ValueError(f"wall position: a finite number is wanted, got {self.position!r}")


@dataclass(frozen=True)
class Solver:
    """Settings of one explicit material point solver.

    Attributes:
        dx: grid spacing [m]; node i lies at i dx.
        nodes: number of nodes per axis.
        dt: time step [s], or None to choose it from the stability limit.
        gradient: ``exact`` B-spline gradient, or the ``mls`` gradient 4/dx^2 w (x_i - x_p).
        decomposition: ``series`` without singular values, or ``svd3``.
        precision: ``float32`` or ``float64``.
        walls: planes that bound the motion.
        mass_eps: mass added to every node in the division [kg].
        margin: distance from the ends of the domain, in cells, at which particles are held;
            None: a particle that leaves is an error.
        gravity: acceleration [m/s^2].
    """

    dx: float
    nodes: tuple[int, int, int]
    dt: float | None = None
    gradient: Gradient = "exact"
    decomposition: Literal["series", "svd3"] = "series"
    precision: Literal["float32", "float64"] = "float32"
    walls: tuple[Wall, ...] = ()
    mass_eps: float = 0.0
    margin: float | None = None
    gravity: tuple[float, float, float] = field(default=(0.0, 0.0, -9.81))

    def __post_init__(self) -> None:
        optional = [v for v in (self.dt, self.margin) if v is not None]
        if not _finite(self.dx, self.mass_eps, *optional, *self.gravity, *self.nodes):
            raise ValueError(f"solver settings: finite numbers are wanted, got {self._numbers()}")
        checks = {
            "three components of gravity": len(self.gravity) == 3,
            "margin >= 0 or none": self.margin is None or self.margin >= 0,
            "dx > 0": self.dx > 0,
            "three node counts from 4 to 2000": len(self.nodes) == 3
            and all(4 <= n <= 2000 for n in self.nodes),
            "whole node counts": _whole(*self.nodes),
            "at most 1e8 nodes": math.prod(self.nodes) <= 1e8,
            "dt > 0 or none": self.dt is None or self.dt > 0,
            "gradient exact or mls": self.gradient in GRADIENTS,
            "decomposition series or svd3": self.decomposition in ("series", "svd3"),
            "precision float32 or float64": self.precision in ("float32", "float64"),
            "mass_eps >= 0": self.mass_eps >= 0,
            "walls at least two cells inside the grid": all(self._inside(w) for w in self.walls),
        }
        broken = [rule for rule, holds in checks.items() if not holds]
        if broken:
            raise ValueError(
                f"solver settings: {'; '.join(broken)} must hold, got {self._numbers()}"
            )
        for wall in self.walls:
            cells = wall.position / self.dx
            if wall.kind == "separate" and abs(cells - round(cells)) > 1e-3:
                raise ValueError(
                    f"separate wall of axis {wall.axis} at {wall.position} m: allowed are whole"
                    f" multiples of dx = {self.dx} m, such as {round(cells) * self.dx:.6g} m;"
                    " slip and stick walls may lie anywhere"
                )

    def _numbers(self) -> str:
        found = {k: v for k, v in vars(self).items() if k != "walls"}
        return ", ".join(f"{k} = {v}" for k, v in found.items())[:300]

    def _inside(self, wall: Wall) -> bool:
        if not self.dx > 0 or len(self.nodes) != 3:
            return True  # refused for that
        cells = wall.position / self.dx
        return bool(2.0 - 1e-6 <= cells <= self.nodes[wall.axis] - 2.0 + 1e-6)
