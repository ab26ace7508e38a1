"""Laws by name."""

from form_drake.laws.additions import ADDITIONS
from form_drake.laws.elastic import FIXED_COROTATED, GENT, MOONEY_RIVLIN, NEO_HOOKEAN, YEOH
from form_drake.laws.flow import BINGHAM, MU_I, NEWTONIAN, WEAKLY_COMPRESSIBLE
from form_drake.laws.law import Law
from form_drake.laws.plastic import DRUCKER_PRAGER, VON_MISES
from form_drake.laws.sums import added

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
OWN: dict[str, Law] = {}  # what form_drake.laws.load has read


def law_named(name: str) -> Law:
    """The law of this name, or the sum of several whose names are joined by ``+``.

    A law from a file of one's own counts once ``form_drake.laws.load`` has read the file.

    Raises:
        ValueError: no law has this name, or those named cannot be added; the message lists what
            can be chosen.
    """
    known = LAWS | ADDITIONS | OWN
    names = [part.strip() for part in name.split("+")]
    for part in names:
        if part not in known:
            raise ValueError(f"unknown law {part!r}: choose one of {', '.join(known)}")
    laws = tuple(known[part] for part in names)
    if all(law.adds_to for law in laws):
        raise ValueError(f"{name} only adds to a law with stiffness: fixed-corotated+{name}")
    return laws[0] if len(laws) == 1 else added(laws)
