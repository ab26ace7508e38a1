"""Where simulation and measurement disagree, and what is missing: effects read along a motion."""

from form_drake.diagnose.reading import ProbeReading

__all__ = ["ProbeReading"]
