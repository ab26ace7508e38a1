"""What a constitutive law is: terms linear in their parameters, constants, and what flows.

Kirchhoff stress [Pa] at a material point q is ``sum_k theta_k T_k(q, s)``; each ``T_k`` is one Warp
function, called both by the simulator and by the columns of the identification. ``s`` holds the
constants in which the law is not linear (Gent's J_m, the mu(I) law's I_0, ...). Laws may be added:
``YEOH + GENT`` is a law like any other, see ``form_drake.laws.sums``.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import warp as wp

Values = Mapping[str, float]
Told = tuple[str, str, Callable[[float], float]]


def nothing(_: Values) -> float:
    """Nothing at all."""
    return 0.0


MOST_CONSTANTS = 4  # what the vector s of the kernels holds
NEEDS = frozenset({"rotation", "strain", "rate"})


@dataclass(frozen=True)
class Term:
    """One parameter in which the stress is linear.

    Attributes:
        key: name of the parameter, as on the command line.
        unit: SI unit of the parameter.
        response: Warp function (q, s) -> Kirchhoff stress per unit of the parameter.
        guess: first guesses; in Pa or Pa s they are per Pa of the scanned Young's modulus.
        given: the parameter is a numerical constant that identification may be told.
        signed: the parameter may be negative; every other one must be positive.
        excited: what to do with the body so that its motion determines the parameter, a phrase.
        tells: what follows from it alone: name, unit and value -> value, such as a friction angle.
    """

    key: str
    unit: str
    response: wp.Function = field(repr=False)
    guess: tuple[float, ...] = (1.0,)
    given: bool = False
    signed: bool = False
    excited: str = "strain the body more"
    tells: Told | None = None


@dataclass(frozen=True)
class Constant:
    """One parameter in which the stress is not linear.

    Attributes:
        key: name of the parameter.
        unit: SI unit.
        role: ``shape`` enters the responses and is searched for, ``given`` enters the responses
            and must be stated, ``yield`` bounds the elastic strain.
        guess: first guesses, as for a term.
        excited: as for a term.
        signed: as for a term.
        tells: as for a term.
        limit: what every value is below, and what that is, a phrase.
    """

    key: str
    unit: str
    role: Literal["shape", "given", "yield"]
    guess: tuple[float, ...] = (1.0,)
    excited: str = "strain the body more"
    signed: bool = False
    tells: Told | None = None
    limit: tuple[float, str] | None = None


@dataclass(frozen=True)
class Law:
    """A constitutive law; see ``LAWS`` for the instances.

    Attributes:
        name: as on the command line.
        parameters: terms and constants in the order in which they are printed.
        moduli: values -> bulk and shear modulus at rest [Pa], linear in the terms' values.
        needs: which of ``rotation``, ``strain`` (Hencky) and ``rate`` the responses read.
        flow: what a step keeps of the trial deformation gradient: all of it (``elastic``), the
            elastic part after a radial return (``plastic``), its volume change (``fluid``), or
            its volume change in compression only (``granular``).
        radius: Warp function (tr e, r) -> largest |dev e| [-] of a plastic law; negative where
            all elastic strain is lost.
        radius_constants: values -> the constants r of ``radius``.
        pressure: Warp function J -> pressure [Pa] per unit ``kappa``, for laws that read it.
        equation: the stress in plain text.
        viscosity: values -> largest viscosity that the responses admit [Pa s].
        stretched: values -> what a direction adds to the modulus of pressure waves along it, beside
            the moduli [Pa].
        adds_to: flows of the laws to which this one is but an addition; empty: it is a law by itself.
        summands: the laws of which this one is the sum, as ``yeoh + gent`` makes it.

    Raises:
        ValueError: two parameters of one name, too many constants, or an unknown need.
    """

    name: str
    parameters: tuple[Term | Constant, ...]
    moduli: Callable[[Values], tuple[float, float]] = field(repr=False)
    equation: str
    viscosity: Callable[[Values], float] = field(default=nothing, repr=False)
    stretched: Callable[[Values], float] = field(default=nothing, repr=False)
    adds_to: frozenset[str] = frozenset()
    needs: frozenset[str] = frozenset()
    flow: Literal["elastic", "plastic", "fluid", "granular"] = "elastic"
    radius: wp.Function | None = field(default=None, repr=False)
    radius_constants: Callable[[Values], tuple[float, ...]] | None = field(default=None, repr=False)
    pressure: wp.Function | None = field(default=None, repr=False)
    summands: tuple["Law", ...] = field(default=(), repr=False)

    def __post_init__(self) -> None:
        held = self.constants("shape", "given")
        if len(set(self.keys)) < len(self.keys):
            raise ValueError(f"{self.name}: two parameters have one name: {', '.join(self.keys)}")
        if len(held) > MOST_CONSTANTS:
            raise ValueError(
                f"{self.name} has {len(held)} constants ({', '.join(held)}): a law or a sum of laws"
                f" may have {MOST_CONSTANTS}"
            )
        if not self.needs <= NEEDS:
            raise ValueError(f"{self.name}: needs may hold {', '.join(sorted(NEEDS))}")

    def __add__(self, other: "Law") -> "Law":
        """The law whose stress is the sum of both, see ``form_drake.laws.sums.added``."""
        if not isinstance(other, Law):
            return NotImplemented
        from form_drake.laws.sums import added  # which itself is made of laws

        return added((*self.parts, *other.parts))

    @property
    def parts(self) -> tuple["Law", ...]:
        """The laws of which this one is the sum; itself, where it is none."""
        return self.summands or (self,)

    @property
    def keys(self) -> tuple[str, ...]:
        return tuple(p.key for p in self.parameters)

    @property
    def terms(self) -> tuple[Term, ...]:
        return tuple(p for p in self.parameters if isinstance(p, Term))

    def constants(self, *roles: str) -> tuple[str, ...]:
        """Keys of the constants with one of the roles, in declared order."""
        return tuple(p.key for p in self.parameters if isinstance(p, Constant) and p.role in roles)

    @property
    def given(self) -> tuple[str, ...]:
        """Keys that identification is told rather than finds."""
        terms = tuple(t.key for t in self.terms if t.given)
        return terms + self.constants("given")

    @property
    def sought(self) -> tuple[str, ...]:
        """Keys that identification finds."""
        return tuple(k for k in self.keys if k not in self.given)

    def parameter(self, key: str) -> Term | Constant:
        return next(p for p in self.parameters if p.key == key)

    def unit(self, key: str) -> str:
        return self.parameter(key).unit

    def theta(self, values: Values) -> np.ndarray:
        """Coefficients of the terms, shape [terms]."""
        return np.array([values[t.key] for t in self.terms])

    def shape_vector(self, values: Values) -> np.ndarray:
        """The vector s of the responses, shape [4]."""
        s = np.zeros(4)
        keys = self.constants("shape", "given")
        s[: len(keys)] = [values[k] for k in keys]
        return s

    def radius_vector(self, values: Values) -> np.ndarray:
        """The vector r of the radius function, shape [4]."""
        r = np.zeros(4)
        if self.radius_constants is not None:
            constants = self.radius_constants(values)
            r[: len(constants)] = constants
        return r

    def wave_speed(self, values: Values, density: float) -> float:
        """Speed of pressure waves at rest [m/s], for a density [kg/m^3]."""
        K, G = self.moduli(values)
        return float(np.sqrt(max(K + 4.0 / 3.0 * G + self.stretched(values), 0.0) / density))
