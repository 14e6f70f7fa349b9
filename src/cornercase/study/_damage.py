"""Turn errors that damaged studies cause into messages of one sentence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Final, TypeVar, Union, cast, get_args, get_origin, get_type_hints

from cornercase._common.errors import InputError

T = TypeVar("T")

_ALLOWED_TYPES: Final[dict[Any, Any]] = {float: float | int, int: int, str: str, NoneType: NoneType}

# Errors that damaged values cause.
_READ_ERRORS: Final = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, RecursionError, MemoryError, StopIteration,
)  # fmt: skip


class DamageError(InputError):
    """Error raised if the content of a study differs from what was written."""

    @classmethod
    def from_problem(cls, path: Path, problem: str) -> DamageError:
        """Return the error that says what is damaged and how to repair it."""
        return cls(f"{path}: is damaged: {problem}; `verify` lists all damage, and repairs it with `repair`.")


@contextmanager
def reraise_read_errors(path: Path) -> Iterator[None]:
    """Turn each error that damaged content causes in the block into an `InputError` whose message names the study.

    A `DamageError` stays as it is.
    """
    try:
        yield
    except DamageError:
        raise
    except InputError as error:
        text = str(error)
        raise InputError(text if str(path) in text else f"{path}: {text}") from error
    except _READ_ERRORS as error:
        raise InputError(
            f"{path}: cannot be used as a study ({type(error).__name__}: {error}); it is damaged, or was not written by"
            " cornercase."
        ) from error


def require_condition(condition: bool, message: str) -> None:
    """Raise `ValueError` with `message` unless `condition` holds; call it within `reraise_read_errors`."""
    if not condition:
        raise ValueError(message)


def dataclass_from_json(dataclass_type: type[T], values: Mapping[str, Any]) -> T:
    """Make a dataclass from values in JSON; `TypeError` if a value is missing, unknown or of another type."""
    for name, allowed in _allowed_types(cast("Any", dataclass_type)).items():
        if name in values and (isinstance(values[name], bool) or not isinstance(values[name], allowed)):
            raise TypeError(f"{dataclass_type.__name__} has {str(values[name])[:60]!r} as its {name}")
    return dataclass_type(**values)


# An analysis is made of hundreds of dataclasses, and Python compiles their annotations at each look.
@cache
def _allowed_types(dataclass_type: type[Any]) -> dict[str, tuple[Any, ...]]:
    """Return the allowed types of each field of a dataclass; fields with nested types are left out."""
    allowed = {}
    for name, hint in get_type_hints(dataclass_type).items():
        # Nested types are not checked.
        types = get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)
        if set(types) <= set(_ALLOWED_TYPES):
            allowed[name] = tuple(_ALLOWED_TYPES[option] for option in types)
    return allowed
