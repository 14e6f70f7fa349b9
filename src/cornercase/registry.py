"""Simulators, optimizers and metrics by name, also those of other packages."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, Generic, TypeVar

from cornercase.errors import InputError, suggestion

T = TypeVar("T")


class Registry(Generic[T]):
    """Factories by name, from this package and from an entry-point group.

    Parameters
    ----------
    kind : str
        What is registered, as it stands in messages: ``"metric"``.
    group : str
        Entry-point group in which other packages name theirs: ``"cornercase.metrics"``.
    """

    def __init__(self, kind: str, group: str) -> None:
        self._kind = kind
        self._group = group
        self._factories: dict[str, Callable[..., T]] = {}

    def register(self, name: str, factory: Callable[..., T]) -> None:
        """Make `factory` known as `name`; a second one of the same name is a programming error."""
        if name in self._factories:
            raise ValueError(f"The {self._kind} '{name}' is registered twice.")
        self._factories[name] = factory

    def names(self) -> list[str]:
        """Return all names in alphabetical order."""
        return sorted({*self._factories, *(entry.name for entry in entry_points(group=self._group))})

    def create(self, name: str, **options: Any) -> T:
        """Build the one called `name`.

        Raises
        ------
        InputError
            No such name.
        """
        if name in self._factories:
            return self._factories[name](**options)
        for entry in entry_points(group=self._group, name=name):
            factory: Callable[..., T] = entry.load()
            return factory(**options)
        raise InputError(f"There is no {self._kind} '{name}'; {suggestion(name, self.names())}")
