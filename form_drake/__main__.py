"""The command line: ``form-drake VERB`` or ``python -m form_drake VERB``."""

import contextlib
import io
import re
import sys
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from form_drake.libraries import explained

COMPONENTS = ("drake", "warp-lang", "numpy", "scipy", "h5py")


def versions() -> str:
    """One line: this package, what it stands on, and the device."""
    import warp as wp

    found = []
    for name in ("form-drake", *COMPONENTS):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            found.append(f"{name} absent")
    device = wp.get_preferred_device()
    return f"{', '.join(found)}, device {device.alias} ({device.name})"


def _parse(arguments: list[str]) -> Any:
    """The command that the arguments name; a mistake in them is one line and exit code 2."""
    import tyro

    from form_drake.commands import COMMANDS, VERBS

    out, err = io.StringIO(), io.StringIO()
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            return tyro.cli(COMMANDS, prog="form-drake", args=arguments, config=config)
    except SystemExit as stop:
        print(out.getvalue(), end="")
        if not stop.code:
            raise
        text = re.sub(r"\x1b\[[0-9;]*m", "", err.getvalue())
        text = " ".join(re.sub(r"[─╭╮╰╯│]+|-{5,}", " ", text).split())
        verb = next((a for a in arguments[:1] if a in VERBS), "")
        text = re.sub(
            r"^(Parsing error|Required options|Unrecognized options|Missing subcommand)", "", text
        )
        text = re.split(r" (?:For full helptext|Arguments similar)", text)[0]
        text = text.strip().rstrip(".")
        raise ValueError(
            f"{text[:400]}; see: form-drake {verb} --help".replace("  ", " ")
        ) from None


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        if arguments == ["--version"]:
            print(versions())
            return 0
        command = _parse(arguments)
        command.run()
    except (ImportError, OSError) as error:
        print(f"form-drake: {explained(error)}", file=sys.stderr)
        return 2
    except ValueError as error:
        print(f"form-drake: {' '.join(str(error).split())}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("form-drake: interrupted; nothing half-written was left", file=sys.stderr)
        return 130
    return 0


if __name__ == "__main__":
    sys.exit(main())
