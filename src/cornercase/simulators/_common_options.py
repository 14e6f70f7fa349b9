"""Options common to all simulators, such as ``time_step``, and selection of options that a simulator declares."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import Parameter, signature
from typing import Any, Final

from cornercase._common.configurable import declared_options, given_options
from cornercase._common.errors import InputError
from cornercase._common.io.support_table import issue_notice_warning
from cornercase._common.registry import parse_options
from cornercase._common.validation import check_str, not_an_object_error
from cornercase.simulators._base import COMMON_OPTIONS, Simulator
from cornercase.simulators._registry import SIMULATORS
from cornercase.simulators._run_options import SIMULATION_OPTIONS

_DEFAULT_OPTIONS: Final = {name: SIMULATION_OPTIONS[name].default for name in COMMON_OPTIONS}


def select_declared_options(name: str, simulator: type[Simulator], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given options without those common options that a simulator's constructor does not declare.

    If such a common option was given with another value than its default, raises `InputError` (``drivers``,
    ``on_collision``) or warns (``time_step``, ``duration``). A constructor with ``**options`` gets all given options.
    """
    declared = declared_options(simulator)
    for key, default in _DEFAULT_OPTIONS.items():
        value = options.get(key)
        if key in declared or value in (None, default):
            continue
        if key == "drivers":
            raise InputError(
                f"`drivers` {', '.join(value)}: the simulator '{name}' supports no drivers; leave them out, or declare"
                " 'drivers' in its constructor."
            )
        if key == "on_collision":
            raise InputError(
                f"`on_collision` {value}: the simulator '{name}' does not declare 'on_collision' in its constructor;"
                " leave it out, or declare it."
            )
        issue_notice_warning(
            f"without effect: {key} {value} s, since the simulator '{name}' does not declare it in its constructor"
        )
    if any(parameter.kind is Parameter.VAR_KEYWORD for parameter in signature(simulator).parameters.values()):
        return dict(options)
    return {key: value for key, value in options.items() if key in declared or key not in _DEFAULT_OPTIONS}


def split_common_options(
    simulator: str | Simulator, options: Mapping[str, Any]
) -> tuple[str | Simulator, dict[str, Any]]:
    """Separate a simulator from common options such as ``time_step``.

    Returns the simulator without these options, and the values of these options. A value comes from the simulator if
    the simulator has the option, otherwise from `options`.
    """
    common = {key: options[key] for key in _DEFAULT_OPTIONS}
    if isinstance(simulator, str):
        stripped, own = _split_simulator_text(check_str("simulator", simulator))
    elif isinstance(simulator, Simulator):
        own = {key: value for key, value in given_options(simulator).items() if key in _DEFAULT_OPTIONS}
    else:
        raise not_an_object_error("simulator", simulator)
    for key, value in own.items():
        if common[key] not in (None, _DEFAULT_OPTIONS[key], value):
            raise InputError(
                f"`{key}`: the simulator {simulator!r} was created with another value; give the option only once."
            )
    if isinstance(simulator, str):
        return stripped, common | own
    declared = declared_options(type(simulator))
    return simulator.with_options(**{key: declared[key].default for key in own}), common | own


def _split_simulator_text(text: str) -> tuple[str, dict[str, Any]]:
    """Split the text of a simulator into a text without common options, such as ``time_step``, and their values.

    Raises `InputError` if the text has the option ``drivers``, whose value is a mapping and not a text.
    """
    name, _, after = text.partition(":")
    if name not in SIMULATORS or SIMULATORS.takes_whole_text(name):
        return text, {}
    parts = after.split(",")
    keys = {part: part.partition("=")[0].strip() for part in parts}
    if "drivers" in keys.values():
        raise InputError(f"The simulator '{name}' does not take drivers after the colon; give `drivers` separately.")
    common = [part for part in parts if keys[part] in COMMON_OPTIONS]
    if not common:
        return text, {}
    values = parse_options("simulator", name, SIMULATORS.get_factory(name), ",".join(common))
    rest = [part for part in parts if part not in common]
    return ":".join([name, ",".join(rest)]) if rest else name, values
