"""Where simulation and measurement disagree, and what is missing: effects read along a motion."""

from form_drake.diagnose.diagnosis import Diagnosis, diagnosed
from form_drake.diagnose.model import Cause, Model, Scenes
from form_drake.diagnose.reading import ProbeReading
from form_drake.diagnose.thresholds import Nulls, thresholds

__all__ = [
    "Cause",
    "Diagnosis",
    "Model",
    "Nulls",
    "ProbeReading",
    "Scenes",
    "diagnosed",
    "thresholds",
]
