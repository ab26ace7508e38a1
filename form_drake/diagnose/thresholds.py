"""Scores by effect that nothing missing may reach: one and a half times the largest of the nulls.

``form-drake bench nulls`` measures them.
"""

import json
from importlib.resources import files

FACTOR = 1.5


def thresholds() -> dict[str, float]:
    """By effect's id, from the nulls that come with the package."""
    text = files("form_drake.diagnose").joinpath("nulls.json").read_text(encoding="utf-8")
    return {name: FACTOR * float(score) for name, score in json.loads(text)["scores"].items()}
