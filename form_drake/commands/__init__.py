"""The verbs of the command line, one frozen dataclass of options each."""

from functools import reduce
from importlib import import_module
from operator import or_
from typing import Annotated, Any

import tyro

VERBS = {
    "demo": ("demo", "Demo"),
    "simulate": ("simulate", "Simulate"),
    "track": ("track", "Track"),
    "identify": ("identify", "Identify"),
    "predict": ("predict", "Predict"),
    "diagnose": ("diagnose", "Diagnose"),
    "check": ("inspect", "Check"),
    "list": ("inspect", "List"),
    "bench": ("bench", "Bench"),
}  # module and class


def command(verb: str) -> Any:
    """The options of a verb; what the others need is not imported."""
    module, name = VERBS[verb]
    return getattr(import_module(f"form_drake.commands.{module}"), name)


def commands() -> Any:
    """The union of all, each under its verb."""
    every = (Annotated[command(verb), tyro.conf.subcommand(verb)] for verb in VERBS)
    return reduce(or_, every)
