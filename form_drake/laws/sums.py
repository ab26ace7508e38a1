"""Sums of laws: one law whose stress is the sum of the stresses of several.

Terms that are one and the same function would be equal columns, so they become one parameter; every
summand's responses read their own constants. Only what a body keeps of its deformation limits what
may be added: elastic laws to each other, fluids to each other, and to a solid what bears nothing by
itself (``Law.adds_to``).
"""

import ast
import inspect
import re
from dataclasses import dataclass, field, replace
from functools import cache
from textwrap import dedent
from typing import Any

import warp as wp

from form_drake.laws.law import Constant, Law, Term, Values

ADDABLE = ("elastic", "fluid")


@dataclass(frozen=True)
class Share:
    """One summand.

    Attributes:
        law: the summand.
        names: its own keys -> keys of the sum.
        repeated: own keys of the terms that an earlier summand brings already.
    """

    law: Law
    names: dict[str, str] = field(default_factory=dict)
    repeated: set[str] = field(default_factory=set)

    def moduli(self, values: Values) -> tuple[float, float]:
        """What it adds to the moduli [Pa] of the sum at the sum's values."""
        return self.law.moduli(self.own(values))

    def own(self, values: Values) -> dict[str, float]:
        """Values by its own keys, zero where an earlier summand has them already."""
        return {k: 0.0 if k in self.repeated else values[name] for k, name in self.names.items()}

    def equation(self) -> str:
        """What it adds to the stress, in the names of the sum."""
        added = [a for a in addends(self.law.equation) if self._adds(a)]
        shown = {k: "0" if k in self.repeated else n for k, n in self.names.items()}
        return re.sub(r"[A-Za-z]\w*", lambda m: shown.get(m[0], m[0]), " + ".join(added))

    def _adds(self, addend: str) -> bool:
        terms = {t.key for t in self.law.terms} & set(re.findall(r"[A-Za-z]\w*", addend))
        return not terms or not terms <= self.repeated


def addends(equation: str) -> list[str]:
    """The parts of a stress between the plus signs that no bracket encloses."""
    found: list[str] = []
    depth = 0
    for part in equation.split(" + "):
        if depth:
            found[-1] += f" + {part}"
        else:
            found.append(part)
        depth += sum((c in "[(") - (c in "])") for c in part)
    return found


@cache
def added(laws: tuple[Law, ...]) -> Law:
    """The sum of laws; the same object for the same laws in the same order.

    Terms whose response is the same function become one under the first law's key, such as the
    ``kappa`` of yeoh and gent. Its value is the sum of theirs. It is ``given`` only if all of them
    are, since a law that seeks the parameter has no other place for what it finds; a given one may
    still be told. It is ``signed`` if one of them is, since then the sum may be negative too.
    Responses that read constants read those of their own law and stay apart. Any other name that is
    taken is prefixed by the later law's name, as in ``gent.mu``.

    Raises:
        ValueError: a law is added to itself, the laws keep different parts of the deformation, or
            there are too many constants.
    """
    _refuse_others(laws)
    parameters: dict[str, Term | Constant] = {}
    columns: dict[wp.Function, str] = {}
    shares = [_joined(law, parameters, columns) for law in laws]

    def moduli(values: Values) -> tuple[float, float]:
        pairs = [share.moduli(values) for share in shares]
        return sum(K for K, _ in pairs), sum(G for _, G in pairs)

    (main, *_) = [share for share in shares if not share.law.adds_to]
    bounded, radius_constants = main.law.radius_constants, None
    if bounded is not None:

        def radius_constants(values: Values) -> tuple[float, ...]:
            return bounded(main.own(values))

    return Law(
        name="+".join(law.name for law in laws),
        parameters=tuple(parameters.values()),
        moduli=moduli,
        equation=" + ".join(filter(None, (share.equation() for share in shares))),
        needs=frozenset[str]().union(*(law.needs for law in laws)),
        flow=main.law.flow,
        radius=main.law.radius,
        radius_constants=radius_constants,
        pressure=main.law.pressure,
        viscosity=lambda v: sum(share.law.viscosity(share.own(v)) for share in shares),
        stretched=lambda v: sum(share.law.stretched(share.own(v)) for share in shares),
        summands=laws,
    )


def _refuse_others(laws: tuple[Law, ...]) -> None:
    names = [law.name for law in laws]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise ValueError(f"{'+'.join(names)}: {twice} is added to itself; name every law once")
    main = [law for law in laws if not law.adds_to]
    kinds = {law.flow for law in main}
    alike = len(main) == 1 or (kinds <= set(ADDABLE) and not any(law.pressure for law in main))
    fits = all(kinds <= law.adds_to for law in laws if law.adds_to)
    if len(kinds) != 1 or not alike or not fits:
        kind = {law.name: "an addition" if law.adds_to else law.flow for law in laws}
        stated = ", ".join(f"{name} is {of}" for name, of in kind.items())
        raise ValueError(
            f"{'+'.join(names)}: {stated}; only elastic laws may be added to each other, fluids that"
            " read no pressure to each other, and additions to the solids that they fit"
        )


def _joined(
    law: Law, parameters: dict[str, Term | Constant], columns: dict[wp.Function, str]
) -> Share:
    """Adds a law's parameters to those of the laws before it and the columns that they have."""
    share, taken = Share(law), set(parameters)
    held = (p for p in parameters.values() if isinstance(p, Constant))
    before = sum(p.role in ("shape", "given") for p in held)
    for p in law.parameters:
        column = columns.get(p.response) if isinstance(p, Term) else None
        if column is not None:
            share.names[p.key] = column
            share.repeated.add(p.key)
            first = parameters[column]
            both = {"given": first.given and p.given, "signed": first.signed or p.signed}
            parameters[column] = replace(first, **both)
            continue
        name = share.names[p.key] = f"{law.name}.{p.key}" if p.key in taken else p.key
        parameters[name] = replace(p, key=name)
        if isinstance(p, Term) and reads_constants(p.response):
            parameters[name] = replace(p, key=name, response=turned(p.response, before))
        elif isinstance(p, Term):
            columns[p.response] = name
    return share


def reads_constants(response: wp.Function) -> bool:
    """Whether a response (q, s) reads its second argument."""
    tree = ast.parse(dedent(inspect.getsource(response.func)))
    s = response.func.__code__.co_varnames[1]
    return any(isinstance(node, ast.Name) and node.id == s for node in ast.walk(tree))


@cache
def turned(response: wp.Function, first: int) -> wp.Function:
    """The response with its own constants starting at index ``first`` of the vector s."""
    if first == 0:
        return response
    i, j, k, m = ((first + n) % 4 for n in range(4))

    @wp.func
    def function(q: Any, s: Any):
        return response(q, wp.vector(s[i], s[j], s[k], s[m]))

    return function
