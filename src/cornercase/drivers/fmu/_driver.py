"""Driver whose decisions are made by an FMU (functional mock-up unit)."""

from __future__ import annotations

import re
import weakref
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.configurable import given_options
from cornercase._common.errors import InputError, PluginError, SimulationError, suggest_name
from cornercase._common.plugin_errors import format_time_of_failure
from cornercase._common.text.sanitize import quote_name, remove_folders
from cornercase._common.typing import BoolArray, FloatArray
from cornercase._common.validation import check_float
from cornercase.drivers._base import Situation
from cornercase.drivers._controls import Controls, Trajectory
from cornercase.drivers._driving_function import DrivingFunction, Start
from cornercase.drivers._mutation_file import read_mutations
from cornercase.drivers.fmu._input_quantities import Traffic
from cornercase.drivers.fmu._mapping import MappedVariable, VariableMap
from cornercase.drivers.fmu._model import FmuVariable, read_fmu
from cornercase.drivers.fmu._osmp_traffic import OsmpTraffic, UnusableMotionError
from cornercase.drivers.fmu._processes import FmuProcessError, FmuProcesses, process_reaper
from cornercase.recordings._osi_messages import require_osi

# Path of an FMU, and options behind a colon.
_SPEC: Final = re.compile(r"(?P<file>.*?\.fmu)(?::(?P<options>.+))?", re.IGNORECASE | re.DOTALL)
_ROUNDING: Final = 1e-6
_Scalar = bool | int | float | str


class FmuDriver(DrivingFunction):
    """Driver whose decisions are made by a functional mock-up unit (FMI 2.0 or 3.0, co-simulation).

    Each concrete scenario has its own instance of the FMU. The instances run in separate processes, so that a crash of
    the FMU fails only the scenario at fault.

    Parameters
    ----------
    file : str
        Path of the FMU.
    map : str, optional
        TOML file that maps quantities of the traffic to the FMU's inputs, and the FMU's outputs to decisions. Without a
        file, the mapping follows from the names and units of the FMU's variables.
    step : float, optional
        Size of the FMU's steps in s; the time step of the simulator must be a multiple of it. By default the step size
        that the FMU declares, or the time step of the simulator if the FMU declares none or writes its motion as an OSI
        message.
    timeout : float, optional
        Longest time in s that a call of the FMU in a time step may take. Loading the FMU, and the start and the end of
        a batch (scenarios that run together), may take 60 s each if that is longer.
    mutations : str, optional
        TOML file with the changes of the FMU's parameters that mutation testing tries.
    **parameters
        Parameters of the FMU by name, in the units of the FMU.

    Raises
    ------
    InputError
        The file is not an FMU for co-simulation, a parameter does not exist, or the map does not fit the FMU.

    Examples
    --------
    >>> import cornercase as cc
    >>> from cornercase.drivers import FmuDriver
    >>> aeb = FmuDriver("aeb.fmu", map="aeb.toml", reaction=0.3)  # doctest: +SKIP
    >>> cc.simulate("cut_in.xosc", drivers={"Ego": aeb})  # doctest: +SKIP
    """

    def __init__(
        self,
        file: str,
        /,
        map: str = "",  # noqa: A002
        step: float | None = None,
        timeout: float = 10.0,
        mutations: str = "",
        **parameters: _Scalar,
    ) -> None:
        self._model = read_fmu(Path(file).absolute())
        self._map = VariableMap(self._model, Path(map).absolute() if map else None)
        self._messages = self._map.messages
        if self._messages:
            require_osi(f"{self._model.path}: an FMU with OSI messages")
        self.step = None if step is None else check_float("step", step, above=0.0)
        self.timeout = check_float("timeout", timeout, above=0.0)
        self._parameters = {name: self._parse_parameter(name, value) for name, value in parameters.items()}
        self._processes: FmuProcesses | None = None
        self._file = file
        self.file_mutations = read_mutations(Path(mutations).absolute()) if mutations else ()
        self.settings = {
            "driver": self._format({name: v for name, v in given_options(self).items() if name != "mutations"}),
            "options": {},
            "sha256": self._model.sha256,
            "model": self._model.name,
            "fmi": self._model.fmi_version,
            "guid": self._model.token,
            **({"map_sha256": self._map.sha256} if map else {}),
        }

    def __str__(self) -> str:
        return str(self.settings["driver"])

    def _format(self, options: Mapping[str, object]) -> str:
        text = ",".join(f"{name}={_format_value(value)}" for name, value in options.items() if name != "file")
        return f"fmu:{self._file}:{text}" if text else f"fmu:{self._file}"

    def spec_with(self, changes: Mapping[str, float]) -> str:
        """Return the driver as text, such as ``fmu:aeb.fmu:reaction=0.3``, with some parameters changed.

        New values of integer parameters are rounded.

        Parameters
        ----------
        changes : mapping of str to float
            New values by name of the parameter.

        Returns
        -------
        str
        """
        rounded = {
            name: value if "Real" in (kind := self._find_parameter(name).kind) or "Float" in kind else round(value)
            for name, value in changes.items()
        }
        return self._format({**given_options(self), **{name: f"{value:g}" for name, value in rounded.items()}})

    def __getstate__(self) -> dict[str, Any]:
        # The process that unpickles the driver starts its own FMU processes.
        return vars(self) | {"_processes": None}

    @property
    def parameters(self) -> dict[str, str]:
        """Start values of the FMU's parameters, by name."""
        return {variable.name: variable.start for variable in self._model.with_causality("parameter")}

    def numeric_parameters(self) -> dict[str, float]:
        """Return the FMU's numeric parameters, which can be dimensions of a search.

        Returns
        -------
        dict of str to float
            Values by name: the value given to this driver, or else the FMU's start value.
        """
        return {
            variable.name: float(self._parameters.get(variable.name, variable.start or 0.0))
            for variable in self._model.with_causality("parameter")
            if variable.is_number and variable.size == 1
        }

    def describe(self) -> Sequence[str]:
        """Return lines of text that name the use of each variable of the FMU.

        Returns
        -------
        sequence of str
            One line per variable, also for unused variables.
        """
        return [
            f"{variable.causality} {variable.name}{f' [{variable.unit}]' if variable.unit else ''}:"
            f" {variable.source or ('not set' if variable.causality == 'parameter' else 'not used')}"
            f"{f' ({variable.remark})' if variable.remark else ''}"
            for variable in self.variables()
        ]

    def variables(self) -> tuple[MappedVariable, ...]:
        """Return all variables of the FMU, each with its use by this driver.

        Returns
        -------
        tuple of MappedVariable
            Inputs, outputs and parameters; `MappedVariable.source` is empty for unused variables.
        """
        parameters = []
        for variable in self._model.with_causality("parameter"):
            given = self._parameters.get(variable.name)
            source = "" if given is None else _format_value(given)
            remark = f"start value {variable.start}" if variable.start and given is None else ""
            parameters.append(MappedVariable(variable.name, "parameter", variable.unit_name, source, remark))
        return (*self._map.listing, *parameters)

    def prepare(self, start: Start) -> None:
        """Load the FMU for a batch (scenarios that run together).

        Parameters
        ----------
        start : Start
            Description of the batch; `Start.parameters` has the FMU parameters that a search varies.
        """
        self._start = start
        self._display_name = f"the driver of {quote_name(start.body.name)} ({remove_folders(str(self))})"
        self._failure: str | None = None
        size, n_steps = self._divide_time_step(start.time_step)
        kinds = {name: self._find_parameter(name) for name in (*self._parameters, *start.parameters)}
        values: dict[str, list[Any]] = {name: [value] for name, value in self._parameters.items()}
        for name, given in start.parameters.items():
            values[name] = [self._parse_parameter(name, float(value)) for value in given]
        self._traffic = OsmpTraffic(self._messages, start) if self._messages else None
        layouts = self._messages.layouts([] if self._traffic is None else self._traffic.static)
        try:
            if self._processes is None:
                folder = process_reaper().make_temporary_folder()
                weakref.finalize(self, process_reaper().remove_folder, folder)
                self._processes = FmuProcesses(
                    self._model.unpack(folder), once_per_process=self._model.once_per_process, timeout=self.timeout
                )
            self._processes.begin_batch(
                start.scenarios,
                self._map.input_layouts,
                self._map.output_layouts,
                [(kinds[name].kind, kinds[name].reference, given) for name, given in values.items()],
                size,
                n_steps,
                layouts,
            )
        except FmuProcessError as error:
            if start.scenarios > 1:
                raise
            self._failure = str(error)

    def decide(self, situation: Situation) -> Controls:
        """Do a time step of the FMU in all active scenarios, and return its decisions.

        Parameters
        ----------
        situation : Situation
            State of the traffic, from which the FMU's inputs are computed.

        Returns
        -------
        Controls
        """
        assert self._processes is not None
        n = len(situation.active)
        if self._failure is not None:
            return self._fail_all(self._failure, situation)
        inputs = self._map.fill_inputs(Traffic(situation, self._start.body, self._start.network))
        messages = [] if self._traffic is None else self._traffic.encode_messages(situation)
        try:
            failed = self._processes.step(situation.active, inputs, messages)
        except FmuProcessError as error:
            if n > 1:
                # The caller tries smaller batches, to find the scenario at fault.
                raise
            self._failure = str(error)
            return self._fail_all(self._failure, situation)
        tables = [self._processes.read_outputs(k) for k in range(len(self._map.output_layouts))]
        decisions = self._map.read_outputs(tables)
        failed |= self._check_decision_ranges(decisions, situation.active, failed)
        controls, trajectories = Controls.empty(n), dict[int, Trajectory]()
        if self._messages.motion is not None:
            failed |= self._read_motion(situation, failed, controls.acceleration, trajectories)
        for name, values in decisions.items():
            target = getattr(controls, name)
            target[:] = np.rint(np.nan_to_num(values)) if name == "lane_change" else values
        return replace(controls, trajectories=trajectories, failures=self._make_errors(failed, situation.time))

    def release(self) -> None:
        """End the batch; the FMU's processes stay ready for the next batch."""
        if self._processes is not None:
            self._processes.end_batch()

    def _fail_all(self, text: str, situation: Situation) -> Controls:
        failed = dict.fromkeys(np.flatnonzero(situation.active).tolist(), text)
        return replace(Controls.empty(len(situation.active)), failures=self._make_errors(failed, situation.time))

    def _make_errors(self, texts: Mapping[int, str], time: float) -> dict[int, SimulationError]:
        instant, failures = format_time_of_failure(time), dict[int, SimulationError]()
        for row, text in texts.items():
            what, colon, why = text.partition(":")
            failures[row] = PluginError(f"{self._display_name} {what}{instant}{colon}{why}")
        return failures

    def _check_decision_ranges(
        self, decisions: Mapping[str, FloatArray], active: BoolArray, failed: Mapping[int, str]
    ) -> dict[int, str]:
        """Return, by scenario, errors for decisions that are not finite or out of range.

        Values that only rounding takes out of range are no error. All decisions are clipped to their ranges in place.
        """
        unusable: dict[int, str] = {}
        for output in self._map.outputs:
            values = decisions[output.decision]
            limits = {"throttle": (0.0, 1.0), "brake": (0.0, 1.0), "lane_change": (-1.0, 1.0)}
            low, high = limits.get(output.decision, (-np.inf, np.inf))
            is_bad = active & (~np.isfinite(values) | (values < low - _ROUNDING) | (values > high + _ROUNDING))
            given = values[is_bad].tolist()
            values.clip(low, high, out=values)
            for row, value in zip(np.flatnonzero(is_bad).tolist(), given, strict=True):
                if row not in failed:
                    bounds = "" if low == -np.inf else f"; it goes from {low:g} to {high:g}"
                    number = "NaN" if np.isnan(value) else f"{value:g}"
                    unusable[row] = (
                        f"failed: its output {output.variable.name} is {number}, which is not usable as"
                        f" {output.decision}{bounds}"
                    )
        return unusable

    def _read_motion(
        self,
        situation: Situation,
        failed: Mapping[int, str],
        acceleration: FloatArray,
        trajectories: dict[int, Trajectory],
    ) -> dict[int, str]:
        """Store the motion that the FMU's OSI messages demand in `acceleration` or `trajectories`.

        Returns the errors of unusable messages, by scenario.
        """
        assert self._processes is not None
        assert self._traffic is not None
        unusable: dict[int, str] = {}
        messages = self._processes.read_messages()
        for row in np.flatnonzero(situation.active).tolist():
            if row in failed:
                continue
            try:
                motion = self._traffic.decode_motion(messages[row][0], situation, row)
            except UnusableMotionError as error:
                unusable[row] = f"failed: {error}"
                continue
            if isinstance(motion, Trajectory):
                trajectories[row] = motion
            else:
                acceleration[row] = motion
        return unusable

    def _divide_time_step(self, time_step: float) -> tuple[float, int]:
        """Return the size of the FMU's steps in s, and the number of FMU steps in a time step of the simulator."""
        own = self._model.step_size
        if self.step is None and own and self._messages.motion is not None:
            # The FMU moves relative to an OSI message, which is new only once per time step of the simulator.
            if not self._model.can_vary_step and abs(own - time_step) > _ROUNDING * time_step:
                raise InputError(
                    f"{self._model.path.name}: the FMU has steps of {own:g} s, and needs new OSI messages in each step;"
                    f" set the simulator's time step to {own:g} s, or give `step={own:g}` if the FMU can do several"
                    " steps with the same messages."
                )
            own = None
        size = self.step or own or time_step
        count = round(time_step / size)
        if count < 1 or abs(count * size - time_step) > _ROUNDING * time_step:
            whose = "the option `step`" if self.step else "the FMU's own step size"
            raise InputError(
                f"{self._model.path.name}: {whose}, {size:g} s, does not divide the time step of {time_step:g} s;"
                " change `step`, or the time step of the simulator."
            )
        return time_step / count, count

    def _find_parameter(self, name: str) -> FmuVariable:
        parameters = {variable.name: variable for variable in self._model.with_causality("parameter")}
        if name not in parameters:
            if name in self._model.by_name:
                causality = self._model.by_name[name].causality
                raise InputError(
                    f"{self._model.path.name}: '{name}' is not a parameter of the FMU; its causality is {causality}."
                )
            hint = suggest_name(name, [*parameters, "map", "step", "timeout", "mutations"])
            raise InputError(f"{self._model.path.name}: the FMU has no parameter '{name}'; {hint}")
        return parameters[name]

    def _parse_parameter(self, name: str, value: _Scalar) -> _Scalar:
        """Return a parameter's value in the type that the FMU declares."""
        variable = self._find_parameter(name)
        wrong = InputError(f"{self._model.path.name}: the parameter '{name}' is a {variable.kind}, not '{value}'.")
        if variable.size > 1 or variable.kind == "Binary":
            raise InputError(
                f"{self._model.path.name}: the parameter '{name}' is an array or binary, which cannot be set."
            )
        if variable.kind == "String":
            return str(value)
        if variable.kind == "Boolean":
            if str(value).lower() in ("true", "false", "1", "0", "1.0", "0.0"):
                return str(value).lower() in ("true", "1", "1.0")
            raise wrong
        if isinstance(value, str) and value in variable.items:
            return variable.items[value]
        try:
            number = float(value)
        except ValueError:
            raise wrong from None
        if not np.isfinite(number):
            raise wrong
        if "Real" in variable.kind or "Float" in variable.kind:
            return number
        if not number.is_integer():
            raise wrong
        return int(number)


def fmu_from_text(text: str = "", /) -> FmuDriver:
    """Driver that is an FMU of FMI 2.0 or 3.0, given as in ``fmu:controller.fmu:map=aeb.toml,reaction=0.3``."""
    match = _SPEC.fullmatch(text)
    if match is None:
        raise InputError(f"The driver 'fmu:{text}' names no FMU; give its file as in 'fmu:controller.fmu:option=1'.")
    options: dict[str, _Scalar] = {}
    for option in match["options"].split(",") if match["options"] else ():
        name, equals, value = (part.strip() for part in option.partition("="))
        if not (name and equals):
            raise InputError(
                f"The driver 'fmu:{text}' has the option '{option}' without a name or value; give options as in"
                f" 'fmu:{match['file']}:name=value'."
            )
        if name in options:
            raise InputError(f"The driver 'fmu:{text}' has the option '{name}' twice; give it once.")
        options[name] = value
    for name in ("step", "timeout"):
        if name in options:
            try:
                options[name] = float(options[name])
            except ValueError:
                raise InputError(
                    f"The driver 'fmu:{text}' takes a number for '{name}', not '{options[name]}'."
                ) from None
    return FmuDriver(match["file"], **options)  # type: ignore[arg-type]


def _format_value(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)
