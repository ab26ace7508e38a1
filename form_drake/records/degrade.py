"""Recordings made poorer on purpose: fewer frames, more noise."""

from dataclasses import replace

import numpy as np

from form_drake.records.recording import Recording


def thinned(recording: Recording, stride: int) -> Recording:
    """Every ``stride``-th frame; full solver states are dropped.

    Raises:
        ValueError: fewer than two frames would be left.
    """
    if stride < 1:
        raise ValueError(f"stride: a whole number from 1 is wanted, got {stride}")
    keep = slice(None, None, stride)
    if len(recording.time[keep]) < 2:
        raise ValueError(f"stride {stride} leaves fewer than two of {recording.frames} frames")
    rows = ("time", "p_WQ", "valid", "visible", "step")
    picked = {k: getattr(recording, k) for k in rows}
    picked = {k: None if v is None else v[keep] for k, v in picked.items()}
    return replace(recording, states=None, **picked)


def degraded(recording: Recording, sigma: float, seed: int) -> Recording:
    """A copy with independent Gaussian noise [m] on every coordinate; the rest shape stays exact.

    Where points of the surface alone are seen, the first frame is none, and as noisy as the others.
    """
    if not sigma >= 0:
        raise ValueError(f"added noise: must not be negative, got {sigma}")
    noise = np.random.default_rng(seed).normal(0.0, sigma, recording.p_WQ.shape)
    level = None if recording.noise is None else float(np.hypot(recording.noise, sigma))
    seen = recording.on_surface and recording.p_reference is None
    reference = None if seen else recording.reference
    return replace(recording, p_WQ=recording.p_WQ + noise, p_reference=reference, noise=level)
