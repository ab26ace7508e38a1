"""Constitutive laws: every row of the paper's Table I and the laws of the shared NCLaw data.

``LAWS`` maps the name of a law, as on the command line, to its one declaration, ``ADDITIONS`` that
of what is only added to one, as in ``fixed-corotated+damping``. Laws may be added,
and laws of one's own come from a Python file: see ``law_named`` and ``load``.
"""

from form_drake.laws.additions import ADDITIONS
from form_drake.laws.elastic import KAPPA
from form_drake.laws.law import Constant, Law, Term, Values
from form_drake.laws.named import LAWS, law_named
from form_drake.laws.own import load
from form_drake.laws.tensor import deviator, isochoric_b

__all__ = [
    "ADDITIONS",
    "KAPPA",
    "LAWS",
    "Constant",
    "Law",
    "Term",
    "Values",
    "deviator",
    "isochoric_b",
    "law_named",
    "load",
]
