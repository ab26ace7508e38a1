"""Constitutive laws: every row of the paper's Table I and the laws of the shared NCLaw data.

``LAWS`` maps the name of a law, as on the command line, to its one declaration.
"""

from form_drake.laws.elastic import FIXED_COROTATED, GENT, MOONEY_RIVLIN, NEO_HOOKEAN, YEOH
from form_drake.laws.flow import BINGHAM, MU_I, NEWTONIAN, WEAKLY_COMPRESSIBLE
from form_drake.laws.law import Constant, Law, Term, Values
from form_drake.laws.plastic import DRUCKER_PRAGER, VON_MISES

LAWS: dict[str, Law] = {
    law.name: law
    for law in (
        NEO_HOOKEAN,
        MOONEY_RIVLIN,
        YEOH,
        GENT,
        FIXED_COROTATED,
        VON_MISES,
        DRUCKER_PRAGER,
        MU_I,
        NEWTONIAN,
        BINGHAM,
        WEAKLY_COMPRESSIBLE,
    )
}


def law_named(name: str) -> Law:
    """The law of this name.

    Raises:
        ValueError: no law has this name; the message lists those that exist.
    """
    if name not in LAWS:
        raise ValueError(f"unknown law {name!r}: choose one of {', '.join(LAWS)}")
    return LAWS[name]


__all__ = ["LAWS", "Constant", "Law", "Term", "Values", "law_named"]
