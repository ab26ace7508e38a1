"""The inside of a body whose surface alone is seen: the motion that balances the forces of a law and
passes through what is seen."""

from form_drake.interior.inside import Inside, inside
from form_drake.interior.path import Path, friction_of
from form_drake.interior.resistance import Resistance, stands
from form_drake.interior.surface import Seen

__all__ = ["Inside", "Path", "Resistance", "Seen", "friction_of", "inside", "stands"]
