"""What frames miss of a motion: a body that is let go rings faster than they tell."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from form_drake.diagnose.between import PARTS, between, denser
from form_drake.diagnose.noise import by_window
from form_drake.identify.problem import Problem
from helpers.twins import MODEL, begun

ROW = "z with plate"


@cache
def read(opens):
    """A twin, and the labels of its rows."""
    match = begun("frictionless", 1.0, opens=opens)
    return match, match.problem.probes[0].labels


@cache
def missed(opens):
    match, _ = read(opens)
    return between(match.problem, match.twin, match.scenes, match.model)


def last(labels):
    ends = max(row.window for row in labels)
    (found,) = (n for n, row in enumerate(labels) if row.window == ends and row.field == ROW)
    return found


def off_and_told(opens):
    """By how much the last row is off beside twins that ring at other moments, and what is said of it."""
    match, labels = read(opens)
    row, off = last(labels), []
    for share in (0.8, 0.9, 1.1, 1.2):
        values = {k: share * v for k, v in MODEL.values.items()}
        other = match.near(replace(MODEL, values=values))
        off.append((match.explains(other) - match.slopes @ match.towards(other.model))[row])
    return np.sqrt(np.mean(np.square(off))), np.linalg.norm(missed(opens)[row])


def test_frames_miss_what_rings_and_nothing_of_what_is_held():
    true, told = off_and_told(opens=True)
    assert 0.3 < true / told < 2.0
    assert max(off_and_told(opens=False)) < 0.1 * min(true, told)


def test_every_window_has_errors_of_its_own():
    match, labels = read(True)
    windows = list(dict.fromkeys(row.window for row in labels))
    own = np.array([windows.index(row.window) for row in labels])
    shared = match.by.shared
    assert shared.shape == (len(labels), 2 * len(windows))
    assert shared == pytest.approx(np.hstack([by_window(match.problem, e) for e in missed(True).T]))
    for n, error in enumerate(shared.T):
        assert not error[own != n % len(windows)].any()


def test_frames_lie_among_those_that_are_seen_and_no_track_is_told():
    match, _ = read(True)
    (seen,) = match.scenes.recordings
    dense = denser(seen)
    assert len(dense.time) == PARTS * (len(seen.time) - 1) + 1
    assert dense.time[::PARTS] == pytest.approx(seen.time)
    assert np.array_equal(dense.reference, seen.reference)
    assert not np.ptp(dense.p_WQ, axis=0).any() and dense.valid is None


def test_motions_that_would_fold_a_body_add_no_error(monkeypatch):
    match, labels = read(True)
    monkeypatch.setattr(Problem, "disturbed", lambda *a: None)
    assert between(match.problem, match.twin, match.scenes, match.model).shape == (len(labels), 0)
