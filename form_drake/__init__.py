"""Material laws identified from one robot interaction, and used to predict and plan, in Drake.

A recording (``read`` or ``Recording.from_arrays``) goes into ``identify``; the ``Material`` that
comes out goes into ``predict`` or into a YAML file.
"""

import sys
from importlib import import_module
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from form_drake.identify import Identification, Unidentifiable, identify
    from form_drake.laws import LAWS
    from form_drake.material import Material, read_material
    from form_drake.mpm.prediction import predict
    from form_drake.records import Recording, Solver, States, Stream, Wall, read, write_recording

__all__ = [
    "LAWS",
    "Identification",
    "Material",
    "Recording",
    "Solver",
    "States",
    "Stream",
    "Unidentifiable",
    "Wall",
    "identify",
    "predict",
    "read",
    "read_material",
    "write_recording",
]

# Imported when first used: the command line can then say in one line which package is missing.
PLACES = {
    "LAWS": "laws",
    "Identification": "identify",
    "Material": "material",
    "Recording": "records",
    "Solver": "records",
    "States": "records",
    "Stream": "records",
    "Unidentifiable": "identify",
    "Wall": "records",
    "identify": "identify",
    "predict": "mpm.prediction",
    "read": "records",
    "read_material": "material",
    "write_recording": "records",
}

if not TYPE_CHECKING:

    def __getattr__(name: str) -> Any:
        if name not in PLACES:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = getattr(import_module(f"{__name__}.{PLACES[name]}"), name)
        return globals()[name]

    def __dir__() -> list[str]:
        return sorted({*globals(), *__all__})


class _Package(ModuleType):
    """``form_drake.identify`` is the function, also once the package of that name is imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in PLACES and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package
