"""Metrics of a user's own class: given as objects, and read from a study without the code of the class."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from math import isfinite
from numbers import Real
from typing import Any, Final

from cornercase._common.configurable import require_storable_options
from cornercase._common.errors import InputError
from cornercase._common.plugin_errors import is_built_in
from cornercase._common.text.sanitize import escape_control_characters
from cornercase._common.typing import FloatArray
from cornercase._common.validation import not_an_object_error, repr_short
from cornercase.metrics._base import Metric
from cornercase.metrics._registry import METRICS
from cornercase.recordings import Recording

_HINT: Final = "derive a class from `cornercase.Metric` and give an object of it, or give the name of a metric"
_UNIT_PATTERN: Final = re.compile(r"[\w%°µ/*^·²³⁻¹() .-]{1,20}")
_NUMBERS: Final = ("cap", "bound", "default_threshold", "contact_score")
_ATTRIBUTES: Final = ("unit", "lower_is_critical", *_NUMBERS, "severity")


class StoredMetric(Metric):
    """A metric without its code, made from its description in a study.

    This is enough to read the courses and scores in the study, but not to compute new ones. Raises `InputError` if the
    description is incomplete.
    """

    def __init__(self, name: str, description: Mapping[str, Any]) -> None:
        self.name, self.description = name, dict(description)
        for attribute in self.description.keys() & set(_ATTRIBUTES):
            setattr(self, attribute, self.description[attribute])
        _check_attributes(self)

    def course(self, recording: Recording, ego: str, other: str) -> FloatArray:
        """Raise `InputError`, since computing a course needs the class of the metric."""
        raise self.make_missing_class_error()

    def make_missing_class_error(self) -> InputError:
        """Return the error that asks for the metric as an object, since scenarios cannot be run without its class."""
        class_name = escape_control_characters(str(self.description.get("class", "unknown")))[:100]
        return InputError(
            f"The metric '{self.name}' is of the class {class_name}; code that a study names is not run, so give the"
            f" metric again as an object, as in Study.open_or_create(path, Problem(…, metrics=[{class_name}()]),"
            " simulator, seed=…)."
        )


def describe_own_metric(metric: Metric) -> dict[str, Any] | None:
    """Return the attributes of a metric that a study stores; they suffice to read the study without the metric's class.

    None for a metric of cornercase itself.
    """
    if isinstance(metric, StoredMetric):
        return metric.description
    if is_built_in(metric):
        return None
    values = {name: getattr(metric, name) for name in _ATTRIBUTES}
    values |= {name: float(values[name]) for name in _NUMBERS if values[name] is not None}
    return {"class": type(metric).__qualname__} | {name: value for name, value in values.items() if value is not None}


def resolve_metric(metric: object, parameter: str = "metrics") -> Metric:
    """Create the metric that a text names, or check a metric object and return this object.

    `parameter` is the name of the parameter in error messages. Raises `InputError` if `metric` cannot be used.
    """
    resolved = METRICS.create(metric) if isinstance(metric, str) and metric else metric
    if not isinstance(resolved, Metric):
        raise not_an_object_error(parameter, metric, _HINT)
    if not is_built_in(resolved):
        _check_attributes(resolved)
        METRICS.check_name_not_taken(resolved)
        if not isinstance(resolved, StoredMetric):
            require_storable_options(resolved)
    return resolved


def as_metric_tuple(metrics: Any) -> tuple[Any, ...]:
    """Return a tuple of metrics from an argument that is one metric or an iterable of metrics."""
    is_several = isinstance(metrics, Iterable) and not isinstance(metrics, str | bytes | Mapping)
    return tuple(metrics) if is_several else (metrics,)


def resolve_metrics(metrics: object, parameter: str = "metrics") -> list[Metric]:
    """Return the metrics that are given by one text or object, or by a sequence of texts and objects, each once.

    Raises `InputError` if a metric cannot be used, or if two different metrics have the same name.
    """
    by_name: dict[str, Metric] = {}
    for item in as_metric_tuple(metrics):
        metric = resolve_metric(item, parameter)
        if by_name.setdefault(metric.name, metric) != metric:
            raise InputError(f"`{parameter}`: two different metrics have the name '{metric.name}'; rename one of them.")
    return list(by_name.values())


def name_or_own_metric(metric: object) -> str | Metric:
    """Return a metric of cornercase as text, and a metric of a user's own class as object.

    Raises `InputError` if an object is no metric. A text is returned unchecked.
    """
    if isinstance(metric, str):
        return metric
    resolved = resolve_metric(metric)
    return str(resolved) if describe_own_metric(resolved) is None else resolved


def _check_attributes(metric: Metric) -> None:
    """Raise `InputError` if an attribute that a subclass has to set is missing, or has another type."""
    for attribute, kind, hint in (
        ("name", str, "a text, such as 'speed-nearby'"),
        ("unit", str, "a text, '1' for none"),
        ("lower_is_critical", bool, "True or False"),
        *((name, Real, "a finite number") for name in _NUMBERS),
    ):
        value = getattr(metric, attribute, None)
        if value is None and attribute in _NUMBERS[1:]:
            continue
        if not isinstance(value, kind) or value == "" or (isinstance(value, Real) and not isfinite(value)):
            problem = "lacks" if value in (None, "") else f"has {repr_short(value)} as"
            raise InputError(f"The metric class {type(metric).__qualname__} {problem} `{attribute}`; set it to {hint}.")
    # A unit from a stranger's study gets into pages and terminals.
    if not _UNIT_PATTERN.fullmatch(metric.unit):
        raise InputError(
            f"The metric class {type(metric).__qualname__} has {repr_short(metric.unit)} as `unit`; set it to at most"
            " 20 letters, digits and signs, such as 'm/s²'."
        )
