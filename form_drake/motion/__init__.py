"""Motion of a body from tracked points: positions, velocities and their gradients everywhere."""

from form_drake.motion.body import Body, Face, body
from form_drake.motion.fit import Fit, fit_tracks, supplied
from form_drake.motion.motion import Motion, Sampling

__all__ = ["Body", "Face", "Fit", "Motion", "Sampling", "body", "fit_tracks", "supplied"]
