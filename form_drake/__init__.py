"""Material laws identified from one robot interaction, and used to predict and plan, in Drake.

A recording (``read`` or ``Recording.from_arrays``) goes into ``identify``; the ``Material`` that
comes out goes into ``predict`` or into a YAML file.
"""

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
