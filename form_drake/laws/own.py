"""Laws of one's own, declared in a Python file as those of this package are."""

import re
import sys
import traceback
from itertools import count
from pathlib import Path
from types import ModuleType

import numpy as np
import warp as wp

from form_drake.laws.additions import ADDITIONS
from form_drake.laws.kernels import READ, responses, types
from form_drake.laws.law import Law, nothing
from form_drake.laws.named import LAWS, OWN

_files: dict[str, Path] = {}
_numbers = count()


def load(path: Path) -> list[Law]:
    """Run a Python file and make the laws that it declares known to ``law_named``.

    A law is a module-level ``Law`` object. Loading a file again replaces its laws.

    Args:
        path: the file; it is run with all rights of this program.

    Returns:
        The laws, in the order in which the file declares them.

    Raises:
        ValueError: one line: there is no such file, it fails, declares no law or a wrong one, or
            the name of one is taken.
    """
    path = Path(path).absolute()
    loaded = {id(law) for law in (LAWS | ADDITIONS | OWN).values()}
    found: dict[int, Law] = {}
    for thing in vars(executed(path)).values():
        if isinstance(thing, Law) and id(thing) not in loaded and not thing.summands:
            found[id(thing)] = thing
    laws = list(found.values())
    if not laws:
        raise ValueError(f"{path}: declares no law; a module-level Law object is wanted")
    names = [law.name for law in laws]
    for law in laws:
        fault = _fault(law)
        if names.count(law.name) > 1:
            fault = "the file declares two laws of this name"
        elif law.name in LAWS | ADDITIONS or _files.get(law.name, path) != path:
            fault = f"the name is taken by {_files.get(law.name, 'a law of this package')}"
        if fault:
            raise ValueError(f"{path}: law {law.name!r}: {fault}")
    for name in [n for n, file in _files.items() if file == path]:
        del _files[name], OWN[name]
    OWN.update(zip(names, laws, strict=True))
    _files.update(dict.fromkeys(names, path))
    return laws


def executed(path: Path) -> ModuleType:
    """A Python file, run.

    Raises:
        ValueError: one line: there is no such file, or it fails, and where.
    """
    try:
        code = compile(path.read_bytes(), str(path), "exec")
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror or error}") from None
    except SyntaxError as error:
        raise ValueError(f"{path}, line {error.lineno}: {error.msg}") from None
    except ValueError as error:
        raise ValueError(f"{path}: no Python file: {error}") from None
    # Warp keeps what it compiles by the module's name, so each run has a name of its own.
    module = ModuleType(f"_form_drake_own_laws_{next(_numbers)}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module
    try:
        exec(code, vars(module))
    except (Exception, SystemExit) as error:
        del sys.modules[module.__name__]
        lines = [f.lineno for f in traceback.extract_tb(error.__traceback__) if _is(f, path)]
        said = (str(error).splitlines() or [""])[0]
        where = f"{path}, line {lines[-1]}" if lines else f"{path}"
        raise ValueError(f"{where}: {type(error).__name__}: {said}") from None
    return module


def _is(frame: traceback.FrameSummary, path: Path) -> bool:
    return frame.filename == str(path)


def _fault(law: Law) -> str | None:
    """What is wrong with a declaration, as far as it shows without a motion."""
    if not re.fullmatch(r"[a-z0-9]+(-[a-z0-9]+)*", law.name):
        return "a name is made of lower-case words joined by hyphens"
    if bad := [k for k in law.keys if not re.fullmatch(r"[A-Za-z]\w*", k, re.ASCII)]:
        return f"parameter {bad[0]!r}: a name is made of letters, digits and underscores"
    if not law.terms:
        return "it has no Term, so no stress"
    if bad := [t.key for t in law.terms if not isinstance(t.response, wp.Function)]:
        return f"the response of {bad[0]} is no Warp function: put @wp.func before it"
    if law.flow not in ("elastic", "plastic", "fluid", "granular"):
        return f"flow {law.flow!r}: choose elastic, plastic, fluid or granular"
    whole = law.radius and law.radius_constants and len(law.constants("yield")) == 1
    if law.flow == "plastic" and not whole:
        return "a plastic law needs radius, radius_constants and one yield constant"
    if any(t.unit == "Pa s" for t in law.terms) and law.viscosity is nothing:
        return "a law with a viscosity must state it, as in viscosity=lambda v: v['eta']"
    if law.pressure and "kappa" not in law.keys:
        return "a law that reads pressure needs a term kappa"
    try:
        K, G = law.moduli({p.key: p.guess[0] for p in law.parameters})
        if not np.isfinite([K, G]).all():
            return f"moduli gives {K} and {G} at the first guesses"
    except Exception as error:
        return f"moduli fails at the first guesses: {type(error).__name__}: {error}"
    return _unbuilt(law)


def _unbuilt(law: Law) -> str | None:
    """What is wrong with the responses, as Warp finds it."""
    try:
        rest = _at_rest(law)
    except Exception as error:
        said = str(error).strip().splitlines()[-1].lstrip(";")
        needs = {member: need for need, member in READ.items()}
        read = re.search(r"`(\w+)` is not an attribute of .*[.]Point[)]", said)
        if read and read[1] in needs:
            wanted = sorted({*law.needs, needs[read[1]]})
            return f"its responses read q.{read[1]}: state needs=frozenset({wanted})"
        if read and read[1] == "p":
            return "its responses read q.p: state a pressure, as Law says, and a term kappa"
        return f"its responses, each from (q, s) to a matrix of 3 by 3, cannot be built: {said}"
    if not np.isfinite(rest).all():
        return "its responses are not finite at rest and at the first guesses"
    return None


def _at_rest(law: Law) -> np.ndarray:
    """Kirchhoff stresses per unit of each term where nothing is deformed, shape [terms, 1, 3, 3]."""
    t, guesses = types("float64"), {p.key: p.guess[0] for p in law.parameters}
    F, L = (wp.array(a[None], dtype=t.mat, device="cpu") for a in (np.eye(3), np.zeros((3, 3))))
    kappa, s = t.real(guesses.get("kappa", 0.0)), t.vec4(*law.shape_vector(guesses))
    out, own = (
        wp.zeros(n, dtype=d, device="cpu") for n, d in (((len(law.terms), 1), t.mat), (0, t.real))
    )
    wp.launch(responses(law, "series", "float64"), 1, [F, L, kappa, own, s, out], device="cpu")
    return np.asarray(out.numpy())
