"""The inside of a body whose surface alone is seen: the motion that balances the forces of a law and
passes through what is seen."""

from form_drake.interior.resistance import Resistance
from form_drake.interior.surface import fit_surface

__all__ = ["Resistance", "fit_surface"]
