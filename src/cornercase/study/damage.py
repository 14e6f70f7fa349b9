"""Turn errors from unusable study content into one-sentence messages."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, TypeVar, Union, get_args, get_origin, get_type_hints

from cornercase._common.errors import InputError

T = TypeVar("T")

_PLAIN: Final[dict[Any, Any]] = {float: float | int, int: int, str: str, NoneType: NoneType}

# Errors that damaged values cause.
_BROKEN: Final = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, MemoryError, StopIteration,
)  # fmt: skip


class DamageError(InputError):
    """The content of a study is not what was written."""

    @classmethod
    def of(cls, path: Path, what: str) -> DamageError:
        """Say what is damaged, and how to repair it."""
        return cls(f"{path}: is damaged: {what}; `verify` lists all damage, and repairs it with `repair`.")


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Turn any error from reading unusable content within the block into an `InputError` that names the study."""
    try:
        yield
    except DamageError:
        raise
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from error
    except _BROKEN as error:
        raise InputError(
            f"{path}: cannot be used as a study ({type(error).__name__}: {error}); it is damaged, or was not written by"
            " cornercase."
        ) from error


def require(holds: bool, what: str) -> None:
    """Raise `ValueError` with `message` unless `condition` holds; call it within `reraise_as_damage`."""
    if not holds:
        raise ValueError(what)


def made(kind: type[T], plain: Mapping[str, Any]) -> T:
    """Make a dataclass from plain values; raise `TypeError` if a value is missing, too many or of another type."""
    for name, hint in get_type_hints(kind).items():
        # Nested types are not checked.
        types = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        allowed = tuple(_PLAIN[option] for option in types) if set(types) <= set(_PLAIN) else ()
        if allowed and name in plain and (isinstance(plain[name], bool) or not isinstance(plain[name], allowed)):
            raise TypeError(f"{kind.__name__} has {str(plain[name])[:60]!r} as its {name}")
    return kind(**plain)
