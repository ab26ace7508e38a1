"""Weak rows of a motion that a solver stepped, read from its positions alone, at every few steps.

Particles are the quadrature points. Positions are interpolated in time; the solver is led along
them, so that F and L follow from the data, from its own transfer and from the law's return map.
Tests are B-splines N_c e_d, much wider than a cell, on a grid fixed in space. A row is used where
no particle inside its support meets a wall of axis d while its window lasts; the body's own surface
is free of traction and needs no margin.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from form_drake.identify.columns import free_rows
from form_drake.identify.start import leader
from form_drake.laws import Law, Values
from form_drake.motion import Motion
from form_drake.mpm.simulation import Body, Simulation
from form_drake.records import Recording, stepped
from form_drake.weak.grid import DEGREE
from form_drake.weak.stress import unit_stresses
from form_drake.weak.system import Row, WeakSystem
from form_drake.weak.windows import Windows, even, windows

ORDER = 5  # of the splines through the positions
APART = 1.5  # knots between neighbouring tests


@dataclass(frozen=True)
class LedOptions:
    """How the rows are made.

    Attributes:
        stride: every so many recorded frames are read.
        width: knot spacing of the tests [cells]; a support is four knots wide.
        window: length of the windows [s].
        overlap: distance of neighbouring windows as a share of their length.
        last: solver steps that are read; None: all.
    """

    stride: int = 2
    width: float = 2.86
    window: float = 0.1
    overlap: float = 0.25
    last: int | None = None


@dataclass(frozen=True)
class Tests:
    """B-splines on a grid fixed in space.

    Attributes:
        axes: centres along each axis [m].
        spacing: of knots [m].
    """

    axes: tuple[np.ndarray, np.ndarray, np.ndarray]
    spacing: float

    @classmethod
    def over(cls, x: np.ndarray, spacing: float) -> "Tests":
        """Tests whose supports reach half their half width beyond all positions x [m]."""
        edge = 0.25 * (DEGREE + 1) * spacing
        low, high = x.min(axis=(0, 1)) + edge, x.max(axis=(0, 1)) - edge
        middle = 0.5 * (low + high)
        counts = 1 + np.maximum((high - low) / (APART * spacing), 0.0).astype(int)
        a, b, c = (
            np.linspace(lo, hi, n) if n > 1 else np.array([m])
            for lo, hi, m, n in zip(low, high, middle, counts, strict=True)
        )
        return cls((a, b, c), spacing)

    @property
    def centres(self) -> np.ndarray:
        """All centres [m], shape [tests, 3]."""
        return np.stack(np.meshgrid(*self.axes, indexing="ij"), axis=-1).reshape(-1, 3)

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values, shape [tests, points], and gradients [1/m], shape [tests, points, 3]."""
        knots = np.arange(DEGREE + 2) - 0.5 * (DEGREE + 1)
        spline = BSpline.basis_element(knots, extrapolate=False)
        steep = spline.derivative(1)
        offset = [(x[:, a] - c[:, None]) / self.spacing for a, c in enumerate(self.axes)]
        value = [np.nan_to_num(spline(s)) for s in offset]
        slope = [np.nan_to_num(steep(s)) / self.spacing for s in offset]

        def product(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
            found: np.ndarray = (a[:, None, None] * b[:, None] * c).reshape(-1, len(x))
            return found

        gradient = [
            product(*(slope[a] if a == axis else value[a] for a in range(3))) for axis in range(3)
        ]
        return product(value[0], value[1], value[2]), np.stack(gradient, axis=-1)


class Led:
    """Weak rows of one recording for any values of a law's parameters.

    Args:
        recording: positions with solver, steps, initial velocities, volumes and density.
        law: whose terms are the columns.
        options: see ``LedOptions``.
        tests: those of another recording of the same scene; None: they cover this motion.
    """

    def __init__(
        self, recording: Recording, law: Law, options: LedOptions, tests: Tests | None = None
    ):
        stated = stepped(recording)
        if stated.solver.dt is None or recording.step is None or recording.v_0 is None:
            raise ValueError("a led motion needs the solver's dt, every frame's step, and v_0")
        self.recording, self.law, self.options = recording, law, options
        self.stated, self.dt = stated, stated.solver.dt
        step = recording.step - recording.step[0]
        read = np.flatnonzero(step <= (options.last or step[-1]))[:: options.stride]
        self.steps = step[read]
        self.x = recording.p_WQ[read].astype(float)
        spline = make_interp_spline(self.steps, self.x.reshape(len(read), -1), k=ORDER)
        every = spline(np.arange(self.steps[-1] + 1))
        self._path = every.reshape(len(every), -1, 3)
        self.v = spline.derivative()(self.steps).reshape(self.x.shape) / self.dt
        self.tests = tests or Tests.over(self.x, options.width * stated.solver.dx)
        self._simulation = leader(recording, law)[0]

    @cached_property
    def windows(self) -> Windows:
        """Windows over the whole motion."""
        time, o = self.steps * self.dt, self.options
        return windows(time, even(time[0], time[-1], o.window, o.overlap * o.window))

    def motion(self, values: Values) -> Motion:
        """The motion, with F and L carried by a law with these values."""
        simulation, x, v_0 = self._simulation, self._path, self.recording.v_0
        assert v_0 is not None
        simulation.set_material(values)
        simulation.reset(self.recording.reference, v_0)
        wanted = {int(n): i for i, n in enumerate(self.steps)}
        F = np.empty((*self.x.shape, 3))
        L = np.empty_like(F)
        for n in range(len(x)):
            if n > 0:
                simulation.step()
            state = simulation.state()
            if n in wanted:
                F[wanted[n]], L[wanted[n]] = state.F, state.L
            v = v_0 if n == 0 else (x[n] - x[n - 1]) / self.dt
            simulation.restore(replace(state, x=x[n], v=v))
        volume = np.broadcast_to(self.stated.volume, len(self.x[0]))
        return Motion(
            time=self.steps * self.dt,
            X=self.x[0],
            x=self.x,
            v=self.v,
            F=F,
            L=L,
            volume=volume,
            mass=volume * self.stated.density,
        )

    @cached_property
    def _fixed(self) -> tuple[np.ndarray, np.ndarray, list[np.ndarray], list[np.ndarray]]:
        """b and which rows hold, [windows, tests, 3]; gradients and their sizes at every time."""
        gravity, mass = np.array(self.stated.solver.gravity), self.stated.mass
        momentum, rest, touched, gradients = [], [], [], []
        for x, v in zip(self.x, self.v, strict=True):
            value, gradient = self.tests.at(x)
            impulse = mass[:, None] * v
            flux = np.einsum("cpj,pj->cp", gradient, v, optimize=True) @ impulse
            momentum.append(value @ impulse)
            rest.append((value @ mass)[:, None] * gravity + flux)
            met = ~free_rows(self.stated.solver, x)
            touched.append((value > 0).astype(float) @ met.astype(float))
            gradients.append(gradient.astype(np.float32))
        chi, rate = self.windows.chi, self.windows.rate
        b = np.tensordot(chi, np.array(rest), 1) + np.tensordot(rate, np.array(momentum), 1)
        free = np.tensordot((chi > 0).astype(float), np.array(touched), 1) == 0.0
        return b, free, gradients, [np.linalg.norm(g, axis=-1) for g in gradients]

    def system(self, values: Values) -> WeakSystem:
        """Rows with F and L carried by a law with these values; sizes as in ``WeakSystem``."""
        motion = self.motion(values)
        b, free, gradients, steepness = self._fixed
        T = unit_stresses(self.law, motion.F, motion.L, values) * motion.volume[:, None, None]
        terms, tests = len(T), len(b[0])
        stress = np.empty((len(gradients), tests, terms, 3))
        size = np.empty((len(gradients), tests, terms))
        strength = np.linalg.norm(T, axis=(-1, -2))
        for n, gradient in enumerate(gradients):
            flat = T[:, n].transpose(1, 3, 0, 2).reshape(-1, terms * 3)
            stress[n] = (gradient.reshape(tests, -1) @ flat).reshape(tests, terms, 3)
            size[n] = steepness[n] @ strength[:, n].T
        chi = self.windows.chi
        A = np.moveaxis(np.tensordot(chi, stress, 1), 2, 3)
        sizes = np.broadcast_to(np.tensordot(chi, size, 1)[:, :, None], A.shape)
        hold = free & (sizes.sum(axis=-1) > 0.0)
        theta = self.law.theta(values)
        return WeakSystem(
            A[hold],
            b[hold],
            np.abs(sizes[hold] * theta).sum(axis=1),
            sizes[hold],
            self._labels(hold),
        )

    def _labels(self, hold: np.ndarray) -> tuple[Row, ...]:
        names = [
            f"{d} about {c[0]:.3f} {c[1]:.3f} {c[2]:.3f} m"
            for c in self.tests.centres
            for d in "xyz"
        ]
        spans = [(float(a), float(z)) for a, z in self.windows.ends]
        where = np.argwhere(hold.reshape(len(spans), -1))
        return tuple(Row(spans[w], names[f]) for w, f in where)

    def rolled(self, values: Values) -> "Led":
        """A rollout of the same scene by a law with these values, read in the same way."""
        step = self.recording.step
        assert step is not None
        whole, recorded = self.recording, step - step[0] <= self.steps[-1]
        shown = replace(
            whole, time=whole.time[recorded], step=step[recorded], p_WQ=whole.p_WQ[recorded]
        )
        return Led(rolled(shown, self.law, values), self.law, self.options, self.tests)


def rolled(recording: Recording, law: Law, values: Values) -> Recording:
    """The scene of a recording, which states its solver, rolled again by a law with some values."""
    stated = stepped(recording)
    simulation = Simulation(
        stated.solver, law, Body(recording.reference, stated.volume, stated.density)
    )
    simulation.set_material(values)
    assert recording.v_0 is not None and recording.step is not None
    simulation.reset(recording.reference, recording.v_0)
    p_WQ = simulation.run(recording.step - recording.step[0])
    return replace(recording, p_WQ=p_WQ, valid=None, noise=None, states=None)
