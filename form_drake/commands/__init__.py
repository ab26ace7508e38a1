"""The verbs of the command line, one frozen dataclass of options each."""

from typing import Annotated

import tyro

from form_drake.commands.bench import Bench
from form_drake.commands.demo import Demo
from form_drake.commands.diagnose import Diagnose
from form_drake.commands.identify import Identify
from form_drake.commands.inspect import Check, List
from form_drake.commands.predict import Predict
from form_drake.commands.simulate import Simulate
from form_drake.commands.track import Track

VERBS = ("demo", "simulate", "track", "identify", "predict", "diagnose", "check", "list", "bench")
COMMANDS = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Track, tyro.conf.subcommand("track")]
    | Annotated[Identify, tyro.conf.subcommand("identify")]
    | Annotated[Predict, tyro.conf.subcommand("predict")]
    | Annotated[Diagnose, tyro.conf.subcommand("diagnose")]
    | Annotated[Check, tyro.conf.subcommand("check")]
    | Annotated[List, tyro.conf.subcommand("list")]
    | Annotated[Bench, tyro.conf.subcommand("bench")]
)
