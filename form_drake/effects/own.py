"""Effects that a person declares in a file of their own."""

from pathlib import Path

from form_drake.effects.effect import Effect
from form_drake.laws import LAWS
from form_drake.laws.own import executed


def load(path: Path, catalogue: dict[str, Effect]) -> dict[str, Effect]:
    """Run a Python file, and find the effects that it declares.

    An effect is a module-level ``Effect`` object.

    Args:
        path: the file; it is run with all rights of this program.
        catalogue: effects that there are, by id.

    Raises:
        ValueError: one line: there is no such file, it fails, declares no effect, the id of one is
            taken, or one cannot say which laws it fits.
    """
    path = Path(path).absolute()
    imported = {id(effect) for effect in catalogue.values()}
    found: dict[str, Effect] = {}
    for thing in vars(executed(path)).values():
        if isinstance(thing, Effect) and id(thing) not in imported:
            if thing.id in catalogue or found.get(thing.id, thing) is not thing:
                raise ValueError(f"{path}: effect {thing.id!r}: the id is taken")
            found[thing.id] = _fitting(thing, path)
    if not found:
        raise ValueError(f"{path}: declares no effect; a module-level Effect object is wanted")
    return found


def _fitting(effect: Effect, path: Path) -> Effect:
    """The effect, which has been asked about every law of this package."""
    for law in LAWS.values():
        try:
            effect.fits(law)
        except Exception as error:
            kind = type(error).__name__
            raise ValueError(
                f"{path}: effect {effect.id!r}: fits fails at law {law.name}: {kind}: {error}"
            ) from None
    return effect
