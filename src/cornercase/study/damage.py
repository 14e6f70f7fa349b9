"""What of a study cannot be used, whoever wrote it, in a sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, TypeVar, Union, get_args, get_origin, get_type_hints

from cornercase._common.errors import InputError

T = TypeVar("T")

_PLAIN: Final[dict[Any, Any]] = {float: float | int, int: int, str: str, NoneType: NoneType}

# What reading a damaged value raises.
_BROKEN: Final = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, MemoryError, StopIteration,
)  # fmt: skip


class DamageError(InputError):
    """What a study holds is not what was written."""

    @classmethod
    def of(cls, path: Path, what: str) -> DamageError:
        """Say what is damaged, and what to do.

        Parameters
        ----------
        path : Path
            Of the study.
        what : str
            What is damaged.

        Returns
        -------
        DamageError
        """
        return cls(f"{path}: is damaged: {what}; `verify` lists all damage, and repairs it with `repair`.")


@contextmanager
def damage_told(path: Path) -> Iterator[None]:
    """Say in a sentence that what is read within the block cannot be used.

    Parameters
    ----------
    path : Path
        Of the study.

    Yields
    ------
    None

    Raises
    ------
    InputError
        Something was missing, or of another type or size than cornercase writes.
    """
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
    """Refuse what a study holds unless a condition holds; within `damage_told`.

    Parameters
    ----------
    holds : bool
    what : str
        What is wrong otherwise.

    Raises
    ------
    ValueError
        It does not hold.
    """
    if not holds:
        raise ValueError(what)


def made(kind: type[T], plain: Mapping[str, Any]) -> T:
    """Make a dataclass of plain values, and refuse those of another type than its numbers and texts have.

    Parameters
    ----------
    kind : type
    plain : mapping of str to object
        Values by field.

    Returns
    -------
    object

    Raises
    ------
    TypeError
        A value is missing, too many, or of another type.
    """
    for name, hint in get_type_hints(kind).items():
        # What is nested is not looked at.
        either = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        allowed = tuple(_PLAIN[one] for one in either) if set(either) <= set(_PLAIN) else ()
        if allowed and name in plain and (isinstance(plain[name], bool) or not isinstance(plain[name], allowed)):
            raise TypeError(f"{kind.__name__} has {str(plain[name])[:60]!r} as its {name}")
    return kind(**plain)
