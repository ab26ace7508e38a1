"""Recordings made poorer on purpose: fewer frames or samples, more noise."""

from dataclasses import replace

import numpy as np

from form_drake.records.recording import Recording

NEAR = 1e-6  # of the time from first to last frame, which clocks round


def thinned(recording: Recording, stride: int) -> Recording:
    """Every ``stride``-th frame; full solver states are dropped.

    Raises:
        ValueError: fewer than two frames would be left.
    """
    if stride < 1:
        raise ValueError(f"stride: a whole number from 1 is wanted, got {stride}")
    kept = np.arange(0, recording.frames, stride)
    if len(kept) < 2:
        raise ValueError(f"stride {stride} leaves fewer than two of {recording.frames} frames")
    return picked(recording, kept)


def picked(recording: Recording, frames: np.ndarray) -> Recording:
    """Some of the frames, by their indices; full solver states are dropped."""
    rows = ("time", "p_WQ", "valid", "visible", "step", "pressure", "body_force")
    own = {k: getattr(recording, k) for k in rows}
    own = {k: None if v is None else v[frames] for k, v in own.items()}
    return replace(recording, states=None, **own)


def framed(recording: Recording) -> Recording:
    """Without the samples of forces that lie before the first frame or after the last.

    What moved then is not recorded, so that no simulation of the frames tells these forces.

    Raises:
        ValueError: fewer than two samples of a force are left.
    """
    first, last = recording.time[[0, -1]]
    near, forces = NEAR * (last - first), {}
    for name, one in recording.forces.items():
        own = (one.time >= first - near) & (one.time <= last + near)
        if own.sum() < 2:
            raise ValueError(
                f"force of {name} is stamped {one.time[0]:.4g} to {one.time[-1]:.4g} s, the frames {first:.4g} to"
                f" {last:.4g} s: two samples or more must lie among the frames"
            )
        forces[name] = replace(one, time=one.time[own], value=one.value[own])
    return replace(recording, forces=forces)


def degraded(recording: Recording, sigma: float, seed: int | list[int]) -> Recording:
    """A copy with independent Gaussian noise [m] on every coordinate; the rest shape stays exact.

    Where points of the surface alone are seen, the first frame is none, and as noisy as the others.
    """
    if not sigma >= 0:
        raise ValueError(f"added noise: must not be negative, got {sigma}")
    noise = np.random.default_rng(seed).normal(0.0, sigma, recording.p_WQ.shape)
    level = None if recording.noise is None else float(np.hypot(recording.noise, sigma))
    seen = recording.on_surface and recording.p_reference is None
    reference, covariance = None if seen else recording.reference, recording.covariance
    if reference is not None and (lost := int(np.sum(~np.isfinite(reference).all(axis=1)))):
        raise ValueError(
            f"added noise: {lost} points are not seen in the first frame, which is their rest shape: state"
            " p_reference, or leave them out"
        )
    if covariance is not None:
        covariance = covariance + sigma**2 * np.eye(3)
    moved = replace(recording, p_WQ=recording.p_WQ + noise, p_reference=reference)
    return replace(moved, noise=level, covariance=covariance)


def restated(recording: Recording, noise: float) -> Recording:
    """With another noise of a coordinate [m]; where points have covariances, on average over them."""
    if recording.covariance is None:
        return replace(recording, noise=noise)
    mean = float(np.trace(recording.covariance, axis1=1, axis2=2).mean()) / 3.0
    return replace(recording, noise=noise, covariance=recording.covariance * noise**2 / mean)
