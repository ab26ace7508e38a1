"""What is sought of a law: linear coefficients, known shares of them, and nonlinear constants."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from form_drake.laws import Law
from form_drake.laws.values import LAME, has_lame, lame
from form_drake.weak.stress import volumetric

Pressure = Literal["law", "free", "supplied"]


@dataclass(frozen=True)
class Unknowns:
    """theta = M phi + known part, and the constants that a search finds.

    Attributes:
        law: the law.
        known: given values.
        keys: names of phi; ``E`` where nu is known in place of mu and lam.
        M: shape [terms, phi].
        offset: known part of theta, shape [terms].
        searched: nonlinear constants that are not known: shapes and yield.
        columns: which terms act on the rows, shape [terms].
        pressure: who balances pressure, see ``of``.
    """

    law: Law
    known: Mapping[str, float]
    keys: tuple[str, ...]
    M: np.ndarray
    offset: np.ndarray
    searched: tuple[str, ...]
    columns: np.ndarray
    pressure: Pressure

    @classmethod
    def of(cls, law: Law, known: Mapping[str, float], pressure: Pressure) -> "Unknowns":
        """What remains to be found of ``law``.

        Args:
            law: the law.
            known: given values; ``nu`` ties mu and lam of a law that has both.
            pressure: ``law``: the law's own volumetric terms balance; ``free``: any pressure may
                act; ``supplied``: the measured one acts. Volumetric terms drop out of the last two.

        Raises:
            ValueError: a yield constant is given without the moduli that turn it into a strain.
        """
        terms = [t.key for t in law.terms]
        acts = np.array([pressure == "law" or not v for v in volumetric(law)])
        nu = known.get("nu")
        tied = nu is not None and has_lame(law)
        keys: list[str] = []
        shares: list[np.ndarray] = []
        for n, key in enumerate(terms):
            share = np.zeros(len(terms))
            if key in known or (tied and key == LAME[1]):
                continue
            if tied and key == LAME[0]:
                assert nu is not None
                for name, one in zip(LAME, lame(1.0, nu), strict=True):
                    share[terms.index(name)] = one
                keys.append("E")
            elif not acts[n]:
                continue
            else:
                share[n] = 1.0
                keys.append(key)
            shares.append(share)
        bound = [k for k in law.constants("yield") if k in known]
        none = dict.fromkeys(law.keys, 0.0)
        stiff = [k for k in keys if k == "E" or any(law.moduli({**none, k: 1.0}))]
        if bound and stiff:
            raise ValueError(
                f"{', '.join(bound)} is given while {', '.join(stiff)} is sought: the elastic strain at"
                " yield would not be known; give the moduli as well, or leave it to be found"
            )
        offset = np.array([known.get(k, 0.0) for k in terms])
        searched = tuple(k for k in law.constants("shape", "yield") if k not in known)
        M = np.array(shares).reshape(-1, len(terms)).T
        return cls(law, known, tuple(keys), M, offset, searched, acts, pressure)

    @property
    def undecided(self) -> tuple[str, ...]:
        """Terms that are neither known nor sought: their pressure cancels in every row."""
        sought = np.abs(self.M).sum(axis=1) > 0
        keys = [t.key for t in self.law.terms]
        return tuple(k for k, s in zip(keys, sought, strict=True) if not s and k not in self.known)

    @property
    def shears(self) -> bool:
        """Whether rows without any pressure tell everything that is sought."""
        shear = [not v for v in volumetric(self.law)]
        return bool(np.all(np.abs(self.M[shear]).sum(axis=0) > 0))

    def theta(self, phi: np.ndarray) -> np.ndarray:
        """Coefficients of all terms."""
        found: np.ndarray = self.M @ phi + self.offset
        return found

    def phi(self, theta: np.ndarray) -> np.ndarray:
        """What gives coefficients theta, which what is known must allow."""
        terms = np.argmax(np.abs(self.M), axis=0) if self.keys else np.zeros(0, dtype=int)
        shares = self.M[terms, np.arange(len(terms))]
        found: np.ndarray = (theta[terms] - self.offset[terms]) / shares
        return found

    def radius(self, r: float) -> dict[str, float]:
        """Values of mu, lam and the yield parameter whose elastic strain is bounded by r."""
        own = {k: v for k, v in self.known.items() if k in self.law.keys}
        ones = dict.fromkeys(self.law.keys, 1.0) | own
        (key,) = self.law.constants("yield")
        assert self.law.radius_constants is not None
        return {**ones, key: r / self.law.radius_constants({**ones, key: 1.0})[0]}

    def yields(self, r: float, theta: np.ndarray) -> float:
        """The yield parameter of a bound r at the coefficients theta."""
        values = dict(zip([t.key for t in self.law.terms], theta, strict=True))
        (key,) = self.law.constants("yield")
        assert self.law.radius_constants is not None
        return r / self.law.radius_constants({**values, key: 1.0})[0]
