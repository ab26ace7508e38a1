"""Diagnoses of cases whose truth is sealed: verdicts are written as they come, and once.

The file of verdicts is a line of JSON for each case after one that names the code and the seal. A run
that was interrupted goes on where it stopped; other code does not go on in the same file.
"""

import fcntl
import hashlib
import json
import os
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from tqdm import tqdm

from form_drake.bench.blind_cases import Case, Probes, Specimens, cases_of
from form_drake.bench.blind_faces import ranking
from form_drake.bench.cases import fingerprint
from form_drake.diagnose import diagnosed, thresholds
from form_drake.diagnose.lesser import lesser
from form_drake.diagnose.score import Score
from form_drake.diagnose.verdict import ROLLED
from form_drake.effects import CATALOGUE
from form_drake.files import plain, read_text, target
from form_drake.workers import copies, forkable, unordered

SECONDS = {"all": 510.0, "press": 290.0, "faces": 140.0}  # a case takes about, on a core of its own
PLACEBOS = 3  # one case of so many has placebos verified too
TOP = 3  # effects that are told of simpler statistics


def sealed(path: Path) -> str:
    """The hash that a seal's file holds.

    Raises:
        ValueError: it holds none.
    """
    words = read_text(path).split()
    if not words or len(words[0]) != 64:
        raise ValueError(f"{path}: a SHA-256 hash of 64 digits is wanted")
    return words[0]


def verdicts(path: Path) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """First line and results of a file of verdicts; a last line that was cut off is none.

    Raises:
        ValueError: it is not such a file, or a case has two verdicts.
    """
    *lines, last = read_text(path).split("\n")
    with suppress(json.JSONDecodeError, RecursionError):
        json.loads(last)
        lines.append(last)
    try:
        head, *rest = [json.loads(line) for line in lines]
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: no verdicts of a blind bench: {error}") from None
    if not (_holds(head, ("code", "seal")) and all(_holds(one, ("id", "verdict")) for one in rest)):
        raise ValueError(f"{path}: no verdicts of a blind bench")
    twice = [n for n, count in Counter(one["id"] for one in rest).items() if count > 1]
    if twice:
        raise ValueError(f"{path}: case {twice[0]} has two verdicts or more, and one run counts")
    return head, rest


def _holds(one: Any, words: Sequence[str]) -> bool:
    return isinstance(one, dict) and all(isinstance(one.get(word), str) for word in words)


def run_blind(
    cases: Path, seal: Path, out: Path, *, only: tuple[str, ...] = (), probes: Probes = "all"
) -> dict[str, Any]:
    """Diagnose every case that has no verdict yet, as many at a time as there are cores.

    Args:
        cases: folder of cases, or a list of seeds.
        seal: file with the hash of the key.
        out: file of verdicts.
        only: parts of ids; cases that contain none of them are left out. Empty: all.
        probes: what is read: ``press`` without the shake, or of both what ``faces`` show, see
            ``form_drake.bench.blind_faces``.

    Raises:
        ValueError: the file of verdicts is of other code, another seal, other probes or other cases,
            or another run writes it; ``only`` leaves no case; or some cannot be made or read, once
            there are verdicts on the rest.
    """
    every = cases_of(cases, faces=probes == "faces")
    wanted = [n for n in every if not only or any(o in n for o in only)]
    if not wanted:
        raise ValueError(f"--only {' '.join(only)}: no id has it; ids are like {min(every)}")
    head = {"code": fingerprint(), "seal": sealed(seal)}
    head |= {} if probes == "all" else {"probes": probes}
    fork, unmade = forkable(), dict[str, str]()
    with _held(target(out)) as file:
        results = _gone_on(file, out, head)
        done = {one["id"] for one in results}
        if strange := sorted(done - set(every)):
            raise ValueError(f"{out}: has a verdict on case {strange[0]}, which {cases} has not")
        left = [n for n in wanted if n not in done]
        hours = len(left) * SECONDS[probes] / 3600.0 / copies(len(left), fork=fork)
        tqdm.write(f"{len(left)} of {len(every)} cases, about {hours:.1f} h", file=sys.stderr)
        one_of = partial(_case, every, probes, head["seal"])
        with closing(unordered(one_of, left, fork=fork)) as made:
            for one in tqdm(made, total=len(left), unit="case", disable=None, leave=False):
                if "unmade" in one:
                    unmade[one["id"]] = one["unmade"]
                    continue
                results.append(one)
                print(json.dumps(one), file=file, flush=True)
    if unmade:
        name, why = next(iter(unmade.items()))
        raise ValueError(
            f"{out}: no verdict on {len(unmade)} cases, which cannot be made or read (run again once they can);"
            f" {name}: {why}"
        )
    return {**head, "results": results}


def _case(every: Mapping[str, Case], probes: Probes, seal: str, name: str) -> dict[str, Any]:
    try:
        seen = every[name]()
    except ValueError as error:
        return {"id": name, "unmade": str(error)}
    begun = _worked()
    try:
        found = _verdict(seen, probes, placebo=_placebo(name, seal))
    except ValueError as error:
        found = {"verdict": "error", "why": str(error)}
    return plain({"id": name, "seconds": _worked() - begun, **found})


@contextmanager
def _held(path: Path) -> Iterator[TextIO]:
    """A file to append to while no other process does.

    Raises:
        ValueError: another does.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a", encoding="utf-8") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(f"{path}: another run writes it; name another --out") from None
        try:
            yield file
        finally:
            fcntl.flock(file, fcntl.LOCK_UN)  # copies of this process that end later hold it too


def _gone_on(file: TextIO, out: Path, head: dict[str, str]) -> list[dict[str, Any]]:
    """Results so far, of a file that is left at the beginning of a line.

    Raises:
        ValueError: it is of other code, another seal or other probes.
    """
    if not out.stat().st_size:
        print(json.dumps(head), file=file, flush=True)
        return []
    begun, results = verdicts(out)
    if begun.get("probes") != head.get("probes"):
        raise ValueError(f"{out}: verdicts of other probes; begin another file")
    if begun != head:
        raise ValueError(
            f"{out}: verdicts of code {begun['code']} and seal {begun['seal'][:12]}; this is"
            f" {head['code']} and {head['seal'][:12]}: one run counts, begin another file"
        )
    lines = out.read_bytes().splitlines(keepends=True)
    if len(lines) > 1 + len(results):  # the last was cut off
        file.truncate(sum(map(len, lines[:-1])))
    elif not lines[-1].endswith(b"\n"):
        print(file=file, flush=True)
    return results


def _placebo(name: str, seal: str) -> int | None:
    """Seed of the placebos of a case, drawn by the seal; None: it has none."""
    drawn = int(hashlib.sha256(f"{seal} {name}".encode()).hexdigest()[:8], 16)
    return None if drawn % PLACEBOS else drawn


def _verdict(seen: Specimens, probes: Probes, *, placebo: int | None) -> dict[str, Any]:
    begun, marks = _worked(), list[tuple[str, float]]()
    read, held, law = seen.chosen(probes)
    if probes == "faces":
        return {"draw": seen.draw, **ranking(read, law)}
    found = diagnosed(
        read,
        law,
        effects=list(CATALOGUE.values()),
        thresholds=thresholds(),
        holdout=held,
        placebo=placebo,
        progress=lambda text: marks.append((text, _worked())),
    )
    told = found.to_json()
    keys = ("verdict", "failed", "doubts", "effects", "values", "gap", "unverified", "placebos")
    kept = {k: told[k] for k in (*keys, "removed")}
    passes = [
        {"residual": p["residual"], "scores": {k: _short(v) for k, v in p["scores"].items()}}
        for p in told["passes"]
    ]
    first = found.naming.passes[0]
    seconds = _worked() - begun  # without the ablation
    simpler = lesser(first.match, CATALOGUE.values())
    return {
        "draw": seen.draw,
        **kept,
        "lesser": {way: _top(every) for way, every in simpler.items()},
        "named": found.naming.verdict,
        "passes": passes,
        "scores": {s.effect.id: _short(s.score) for s in first.ranked},
        "limits": {s.effect.id: s.limit for s in first.ranked},
        "reading": next(time for text, time in marks if text == ROLLED) - begun,
        "seconds": seconds,
    }


def _worked() -> float:
    """Processor time of this process and its children [s], which other work beside it does not change."""
    return float(sum(os.times()[:4]))


def _top(found: Sequence[Score]) -> dict[str, float]:
    return {s.effect.id: _short(s.score) for s in found[:TOP]}


def _short(score: float) -> float:
    return float(f"{score:.4g}")


def table(result: Mapping[str, Any]) -> str:
    """As printed: how often each verdict was given."""
    counts: dict[str, int] = {}
    for one in result["results"]:
        counts[one["verdict"]] = counts.get(one["verdict"], 0) + 1
    lines = [f"code {result['code']}, seal {result['seal'][:12]}", ""]
    return "\n".join([*lines, *(f"{k:10} {n:4d}" for k, n in sorted(counts.items()))])
