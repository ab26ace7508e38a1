"""The command line: ``form-drake VERB`` or ``python -m form_drake VERB``."""

import io
import json
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from typing import Any

from form_drake.libraries import explained

# before numpy: matrices here are small, and a second thread that waits for a busy core costs tenfold
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

VISIBLE = "CUDA_VISIBLE_DEVICES"
COMPONENTS = ("drake", "warp-lang", "numpy", "scipy", "h5py")
ABOUT = (
    "Material laws identified from one robot interaction, and used to predict and plan."
    " form-drake --version [--json] names the versions and the device in use."
)


def versions(*, as_json: bool) -> str:
    """One line: this package, what it stands on, and the device."""
    from importlib.metadata import PackageNotFoundError, version

    import warp as wp

    found: dict[str, str | None] = {}
    for name in ("form-drake", *COMPONENTS):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    device = wp.get_preferred_device()
    if as_json:
        named = {"alias": device.alias, "name": device.name}
        return json.dumps({"versions": found, "device": named})
    listed = ", ".join(f"{name} {number or 'absent'}" for name, number in found.items())
    return f"{listed}, device {device.alias} ({device.name})"


def _parse(arguments: list[str]) -> Any:
    """The command that the arguments name; a mistake in them is one line and exit code 2."""
    import tyro

    from form_drake.commands import VERBS, command, commands

    out, err = io.StringIO(), io.StringIO()
    verb = next((a for a in arguments[:1] if a in VERBS), "")
    config = (tyro.conf.FlagCreatePairsOff, tyro.conf.OmitSubcommandPrefixes)
    try:
        with redirect_stdout(out), redirect_stderr(err):
            if verb:
                prog = f"form-drake {verb}"
                return tyro.cli(command(verb), prog=prog, args=arguments[1:], config=config)
            return tyro.cli(
                commands(), prog="form-drake", args=arguments, config=config, description=ABOUT
            )
    except SystemExit as stop:
        print(_plainer(out.getvalue()), end="", flush=True)
        if not stop.code:
            raise
        text = re.sub(r"\x1b\[[0-9;]*m", "", err.getvalue())
        text = " ".join(re.sub(r"[─╭╮╰╯│]+|-{5,}", " ", text).split())
        text = re.sub(
            r"^(Parsing error|Required options|Unrecognized options|Missing subcommand|Invalid choice)",
            "",
            text,
        )
        text = _typed(text)
        text = re.split(r" (?:For full helptext|Arguments similar|Perhaps you meant)", text)[0]
        text = text.replace(" Available subcommands:", "; choose from").strip().rstrip(".")
        unknown = re.search("Expected one of|choose from", text)
        within = arguments[1] if verb == "bench" and not unknown else ""
        words = ("form-drake", verb, "" if within.startswith("-") else within, "--help")
        raise ValueError(f"{text[:400]}; see: {' '.join(filter(None, words))}") from None


def _plainer(text: str) -> str:
    """Help without what says nothing: that an option may be left out, and that nothing stands for it then."""
    text = re.sub(r"\{None\}\|(\S+)", rf"\1{'':7}", text)
    text = re.sub(r"\{None,(\S+\})", rf"{{\1{'':5}", text)
    nothing = r"\(default:\s*(?:None|False|'')?\) *"
    return re.sub(rf" *{nothing}", "", re.sub(rf"\n +{nothing}(?=\n)", "", text))


def _typed(text: str) -> str:
    """What a parser says of a value of another type, in its place where it says no such thing."""
    found = re.match(
        r"Value error Error parsing (\S+): .*?'([^']*)'.* Argument helptext: \1 (?:\{None\}\|)?(\S+)",
        text,
    )
    if found is None:
        return text
    option, got, kind = found.groups()
    wanted = {"FLOAT": "a number", "INT": "a whole number"}.get(kind, kind)
    return f"{option} {got}: {wanted} is wanted"


def _run(arguments: list[str]) -> None:
    """Run one command; everything heavy is imported from here on."""
    asked = sorted(arguments) in (["--version"], ["--json", "--version"])
    command = None if asked else _parse(arguments)

    import warp as wp

    wp.config.log_level = wp.LOG_ERROR
    wanted = asked or re.search(r"\bdevice[ =](?!cpu\b)", " ".join(arguments))
    with nullcontext() if wanted else _no_gpu():
        _quietly(wp.init)
    if command is None:
        print(versions(as_json="--json" in arguments))
    else:
        command.run()
    sys.stdout.flush()


@contextmanager
def _no_gpu() -> Iterator[None]:
    """Let CUDA find no GPU if it begins here: only a process without one may fork onto all cores."""
    seen = os.environ.get(VISIBLE)
    os.environ[VISIBLE] = ""
    try:
        yield
    finally:
        del os.environ[VISIBLE]
        if seen is not None:
            os.environ[VISIBLE] = seen


def _quietly(action: Callable[[], object]) -> None:
    """Do something whose libraries write to standard error where a driver is missing."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        action()
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def _open() -> None:
    """Open to nowhere what standard streams are closed, lest a file be written in their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))


def _unheard() -> None:
    """Point the standard streams to nowhere, so that the interpreter's last flush succeeds."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            os.dup2(nowhere, stream.fileno())
    os.close(nowhere)


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    _open()
    if arguments is None:  # this process is the command's own
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        _run(sys.argv[1:] if arguments is None else arguments)
    except BrokenPipeError:  # the reader of the output has seen enough
        _unheard()
        return 141
    except (ImportError, OSError) as error:
        problem = explained(error)
    except ValueError as error:
        problem = " ".join(str(error).split())
    except (MemoryError, RuntimeError) as error:
        text = " ".join(str(error).split())
        if not isinstance(error, MemoryError) and not re.search("allocat|out of memory", text):
            raise
        problem = f"not enough memory: {text}" if text else "not enough memory"
    except KeyboardInterrupt:
        print("form-drake: interrupted; nothing half-written was left", file=sys.stderr)
        return 130
    else:
        return 0
    print(f"form-drake: {problem}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    sys.exit(main())
