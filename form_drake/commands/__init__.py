"""The verbs of the command line, one frozen dataclass of options each."""

import ast
from dataclasses import make_dataclass
from functools import reduce
from importlib import import_module
from importlib.resources import files
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
    """The union of all, each under its verb: their first lines alone, for which nothing is imported."""
    every = (Annotated[_told(verb), tyro.conf.subcommand(verb)] for verb in VERBS)
    return reduce(or_, every)


def _told(verb: str) -> type:
    """A class that has the docstring of a verb's options, and no option."""
    module, name = VERBS[verb]
    tree = ast.parse((files(__name__) / f"{module}.py").read_text())
    (own,) = (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == name)
    return make_dataclass(name, [], namespace={"__doc__": ast.get_docstring(own)})
