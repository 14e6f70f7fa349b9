"""Driver whose decisions are made by an external program."""

from __future__ import annotations

import difflib
import hashlib
import math
import shutil
import sys
import weakref
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from cornercase._common.configurable import format_option_value
from cornercase._common.errors import InputError, PluginError, RunLostError, SimulationError, suggest_name
from cornercase._common.platform import split_command
from cornercase._common.plugin_errors import format_time_of_failure
from cornercase._common.text.sanitize import escape_control_characters, quote_name, remove_folders, shorten
from cornercase._common.typing import FloatArray
from cornercase._common.validation import check_float, repr_short
from cornercase._common.version import __version__
from cornercase.drivers._attached_driver import DriverError
from cornercase.drivers._base import Situation
from cornercase.drivers._controls import Controls
from cornercase.drivers._driving_function import DrivingFunction, Start
from cornercase.drivers._mutation_file import read_mutations
from cornercase.drivers._registry import SEPARATOR, split_spec
from cornercase.drivers.process._columns import COLUMNS, PATH_COLUMNS, compute_columns, select_rows
from cornercase.drivers.process._messages import (
    ANSWER_COLUMNS,
    PROTOCOL_VERSION,
    ProtocolError,
    pack_column,
    read_answer,
)
from cornercase.drivers.process._program import (
    TCP_PREFIX,
    Connection,
    Peer,
    Program,
    parse_address,
    resolve_command_words,
)

_MAX_FAILURE_LENGTH, _MAX_POINTS = 500, 1000
# Default time limits in s.
_TIMEOUT, _START_TIMEOUT = 10.0, 60.0
_OWN_OPTIONS: Final = ("timeout", "start_timeout", "log", "mutations")
# Similarity from which a name counts as a misspelling of one of these options.
_MISSPELT: Final = 0.85


class ProcessFunction(DrivingFunction):
    """Driver that is an external program, which answers messages of cornercase: see ``docs/process.md``.

    The program is started with the first batch (scenarios that run together). In each step, the program is sent the
    situation in all scenarios of the batch, and answers with controls. A program that crashes, hangs, or gives an
    invalid answer is started again for the next batch.

    Parameters
    ----------
    command : str
        Program and arguments, split into words as in a shell, but run without a shell; or the address
        ``tcp://HOST:PORT`` of a program that listens there. Options may follow after the last colon, as in
        ``"./function --fast:timeout=2,reaction=0.3"``.
    timeout : float, default 10
        Time limit in s for the answer to a step.
    start_timeout : float, default 60
        Time limit in s for the program to start, and to prepare a batch.
    log : str, optional
        File to which the program's stderr is appended.
    mutations : str, optional
        TOML file with the changes of the program's options that mutation testing tries.
    **options : bool, int, float or str
        Options of the program itself.

    Raises
    ------
    InputError
        There is no such program, or an option is wrong.

    Examples
    --------
    >>> from cornercase.drivers import ProcessFunction
    >>> str(ProcessFunction("python my_function.py", timeout=2.0, reaction=0.3))
    'exec:python my_function.py:timeout=2.0,reaction=0.3'
    """

    name = "exec"

    def __init__(
        self, command: str = "", /, *, timeout: float = _TIMEOUT, start_timeout: float = _START_TIMEOUT, log: str = "",
        mutations: str = "", **options: Any,
    ) -> None:  # fmt: skip
        self._command, in_text = _split_options(command)
        defaults = {"timeout": _TIMEOUT, "start_timeout": _START_TIMEOUT, "log": "", "mutations": ""}
        own = {"timeout": timeout, "start_timeout": start_timeout, "log": log, "mutations": mutations}
        given = {
            option: in_text.pop(option, defaults[option]) if value == defaults[option] else value
            for option, value in own.items()
        }
        self.options: dict[str, bool | float | str] = in_text | options
        """Options of the program itself."""
        for option, value in self.options.items():
            if not isinstance(value, bool | int | float | str):
                raise InputError(f"The option `{option}` of a program is not a number, a text, True or False.")
        self._timeout, self._start_timeout = (
            check_float(option, given[option], above=0.0) for option in ("timeout", "start_timeout")
        )
        self._log = Path(str(given["log"])) if given["log"] else None
        if self._log is not None and not self._log.absolute().parent.is_dir():
            raise InputError(f"The option `log` of a program: there is no folder {self._log.parent} for {self._log}.")
        try:
            self._words = [] if self._command.startswith(TCP_PREFIX) else split_command(self._command)
        except ValueError as error:
            raise InputError(f"The driver 'exec:{self._command}' cannot be split into words: {error}.") from error
        if self._words:
            resolve_command_words(self._command, self._words)
        elif self._command.startswith(TCP_PREFIX):
            parse_address(self._command)
        else:
            raise InputError("The driver 'exec:' needs a command, as in exec:./function or exec:python my_function.py.")
        self.file_mutations = read_mutations(Path(str(given["mutations"])).absolute()) if given["mutations"] else ()
        self._given = {option: value for option, value in given.items() if value != defaults[option]} | self.options
        self._text = self._format({name: value for name, value in self._given.items() if name != "mutations"})
        # A study stores this text together with sensors and vehicle, and parses it again.
        if split_spec(self._text)[1]:
            raise InputError(
                f"The driver '{self._text}' contains '{SEPARATOR}', which separates driver and sensors; if it belongs"
                " to the command, put it in double quotes."
            )
        self.settings = {"driver": self._text, "options": {}, **_hash_command_files(self._words)}
        self._peer: Peer | None = None

    def __str__(self) -> str:
        return self._text

    def _format(self, options: Mapping[str, object]) -> str:
        texts = [f"{option}={format_option_value(value)}" for option, value in options.items()]
        return f"exec:{self._command}" + (f":{','.join(texts)}" if texts else "")

    def spec_with(self, changes: Mapping[str, float]) -> str:
        """Return the driver as text, such as ``exec:./function:reaction=0.3``, with some options changed.

        Parameters
        ----------
        changes : mapping of str to float
            New values by name of the option; they are rounded to six significant digits.

        Returns
        -------
        str
        """
        return self._format(self._given | {name: f"{value:g}" for name, value in changes.items()})

    options_may_vary = True

    def options_in_force(self) -> Mapping[str, object]:
        """Return the time limits in s, the log, and the options of the program.

        Returns
        -------
        mapping of str to object
        """
        attachment = {"timeout": self._timeout, "start_timeout": self._start_timeout}
        return {**attachment, **({} if self._log is None else {"log": str(self._log)}), **self.options}

    def numeric_parameters(self) -> dict[str, float]:
        """Return the numeric options of the program, which can be dimensions of a search.

        Returns
        -------
        dict of str to float
        """
        return {
            name: float(value)
            for name, value in self.options.items()
            if isinstance(value, int | float) and not isinstance(value, bool)
        }

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for pickling, without the running program: another process starts its own program."""
        return {name: value for name, value in vars(self).items() if name != "_end"} | {"_peer": None}

    def prepare(self, start: Start) -> None:
        """Start the program if it does not run, and send it the description of the batch.

        Parameters
        ----------
        start : Start
            Description of the batch.

        Raises
        ------
        InputError
            The program cannot be used.
        DriverError
            The program drives one scenario at a time, and the batch has several scenarios.
        """
        self._display_name = f"the driver of {quote_name(start.body.name)} ({remove_folders(self._text)})"
        self._others: list[tuple[Any, ...]] | None = None
        if self._peer is None:
            self._connect()
        if start.scenarios > self._at_once:
            # The simulator then runs them one by one.
            raise DriverError(PluginError(f"{self._display_name} drives one scenario at a time"), splits=False)
        message = {
            "type": "start",
            "scenarios": start.scenarios,
            "time_step": start.time_step,
            "ego": vars(start.body),
            "parameters": {name: pack_column(values) for name, values in start.parameters.items()},
            "values": [dict(values) for values in start.values],
            "seeds": [int(start.generator(n, "driver").integers(2**53)) for n in range(start.scenarios)],
            "friction": pack_column(start.friction),
        }
        answer = self._request_answer(message, "ready", self._start_timeout, 0.0)
        try:
            _, failures = read_answer(answer, start.scenarios)
        except ProtocolError as error:
            raise self._fail(str(error), 0.0) from error
        self._failures = {n: self._make_scenario_error(text, 0.0) for n, text in failures.items()}

    def decide(self, situation: Situation) -> Controls:
        """Send the situation to the program, and return its decisions in all active scenarios."""
        n_scenarios, rows = len(situation.active), np.flatnonzero(situation.active)
        seen = select_rows(situation, rows)
        columns = compute_columns(seen, self._wanted, self._ahead)
        message: dict[str, Any] = {
            "type": "step",
            # As in `View`: without the rounding errors of sums of time steps.
            "time": round(situation.time, 9),
            "time_step": situation.time_step,
            "scenarios": rows.tolist(),
            "columns": {name: pack_column(values) for name, values in columns.items()},
        }
        boxes = (situation.others_length, situation.others_width, situation.others_center_x)
        others = list(
            zip(situation.others_name, situation.others_object_type, *(box.tolist() for box in boxes), strict=True)
        )
        # The list changes only with false objects of sensors.
        if others != self._others:
            self._others = others
            names = ("name", "object_type", "length", "width", "center_x")
            message["others"] = [dict(zip(names, other, strict=True)) for other in others]
        if seen.signals:
            message["signals"] = {name: states.tolist() for name, states in seen.signals.items()}
        answer = self._request_answer(message, "control", self._timeout, situation.time)
        try:
            decided, failures = read_answer(answer, len(rows))
        except ProtocolError as error:
            raise self._fail(str(error), situation.time) from error
        controls, numbers = Controls.empty(n_scenarios), rows.tolist()
        for name in ANSWER_COLUMNS:
            getattr(controls, name)[rows] = getattr(decided, name)
        return replace(
            controls,
            trajectories={numbers[row]: trajectory for row, trajectory in decided.trajectories.items()},
            # A failure at the start of the batch is the reason for later failures.
            failures={numbers[row]: self._make_scenario_error(text, situation.time) for row, text in failures.items()}
            | {n: failure for n, failure in self._failures.items() if situation.active[n]},
        )

    def release(self) -> None:
        """Tell the program that the batch has ended; the program stays ready for the next batch."""
        if self._peer is not None:
            self._peer.send({"type": "end"})

    def close(self) -> None:
        """End the program; the next batch starts it again."""
        if self._peer is not None:
            self._end()
            self._peer = None

    def _connect(self) -> None:
        """Start the program, or connect to it, and agree on the protocol; `InputError` if this fails."""
        where = f"The driver '{self._text}'"
        try:
            if self._words:
                peer: Peer = Program(resolve_command_words(self._command, self._words), self._log)
            else:
                peer = Connection(*parse_address(self._command), self._start_timeout)
        except OSError as error:
            raise InputError(f"{where} cannot be started: {error.strerror or error}.") from error
        self._end, self._peer = weakref.finalize(self, peer.close), peer
        hello = {
            "type": "hello",
            "protocol": PROTOCOL_VERSION,
            "cornercase": __version__,
            "options": self.options,
            "columns": [*COLUMNS],
        }
        try:
            self._read_hello(peer.request_answer(hello, self._start_timeout))
        except ProtocolError as error:
            self.close()
            raise InputError(f"{where} cannot be used: {error}.") from error
        except BaseException:
            self.close()
            raise

    def _read_hello(self, answer: Mapping[str, Any]) -> None:
        if isinstance(answer.get("error"), str):
            raise ProtocolError(_on_one_line(answer["error"]))
        if answer.get("type") != "hello":
            raise ProtocolError(f"its first message is of the type {answer.get('type')!r}, not 'hello'")
        if answer.get("protocol") != PROTOCOL_VERSION:
            raise ProtocolError(
                f"it has version {answer.get('protocol')!r} of the protocol, cornercase has version {PROTOCOL_VERSION}"
            )
        self._at_once = 1 if answer.get("one_at_a_time") is True else sys.maxsize
        self._check_options(answer.get("options"))
        ahead = answer.get("ahead")
        try:
            self._ahead: FloatArray = np.array([] if ahead is None else ahead, dtype=np.float64)
        except (TypeError, ValueError):
            raise ProtocolError("its 'ahead' is not a list of distances in m") from None
        if self._ahead.ndim != 1 or len(self._ahead) > _MAX_POINTS or not np.isfinite(self._ahead).all():
            raise ProtocolError(f"its 'ahead' is not a list of at most {_MAX_POINTS} distances in m")
        self._wanted = self._read_wanted_columns(answer.get("columns"))

    def _check_options(self, listed: object) -> None:
        """Raise `InputError` for an option that is not in the list of options that the program takes.

        If the program gives no list (None), only options that look like a misspelt ``timeout`` or similar are refused.
        """
        if listed is None:
            for name in self.options:
                if (own := _find_misspelt_option(name)) is not None:
                    raise InputError(
                        f"The driver '{self._text}' has the option '{name}'; the program does not say which options it"
                        f" takes; did you mean '{own}'?"
                    )
            return
        if not isinstance(listed, list) or not all(isinstance(name, str) for name in listed):
            raise ProtocolError(f"its 'options' are not a list of names, but {repr_short(listed)}")
        for name in self.options:
            if name not in listed:
                raise InputError(
                    f"The driver '{self._text}' has no option '{name}'; {suggest_name(name, (*listed, *_OWN_OPTIONS))}"
                )

    def _read_wanted_columns(self, wanted: object) -> list[str]:
        """Check the names of the columns that a program wants; return these names without columns about the path."""
        if wanted is None:
            return [*COLUMNS]
        if not isinstance(wanted, list) or not all(isinstance(name, str) for name in wanted):
            raise ProtocolError(f"its 'columns' are not a list of names, but {repr_short(wanted)}")
        if unknown := [name for name in wanted if name not in COLUMNS and name not in PATH_COLUMNS]:
            hint = suggest_name(unknown[0], (*COLUMNS, *PATH_COLUMNS)).rstrip(".?")
            raise ProtocolError(f"it wants the column '{unknown[0]}', which does not exist; {hint}")
        of_path = [name for name in wanted if name in PATH_COLUMNS]
        if of_path and not len(self._ahead):
            raise ProtocolError(
                f"it wants the column '{of_path[0]}', but does not give 'ahead', the list of distances in m at which it"
                " wants points of the path"
            )
        return [name for name in wanted if name in COLUMNS]

    def _request_answer(self, message: Mapping[str, Any], expected: str, timeout: float, time: float) -> dict[str, Any]:
        assert self._peer is not None
        try:
            answer = self._peer.request_answer(message, timeout)
            if answer.get("type") != expected:
                raise ProtocolError(f"it answered with the type {answer.get('type')!r}, not {expected!r}")
        except ProtocolError as error:
            raise self._fail(str(error), time) from error
        except BaseException:
            # A pending answer would be mistaken for the answer to the next message.
            self.close()
            raise
        return answer

    def _fail(self, reason: str, time: float) -> SimulationError:
        """End the program, and return the error for all scenarios of the batch."""
        was_killed = self._peer is not None and self._peer.was_killed
        self.close()
        message = f"{self._display_name} failed{format_time_of_failure(time)}: {reason}"
        return RunLostError(message) if was_killed else PluginError(message)

    def _make_scenario_error(self, text: str, time: float) -> SimulationError:
        """Return the error of one scenario, with the reason `text` that the program gives."""
        return PluginError(f"{self._display_name} failed{format_time_of_failure(time)}: {_on_one_line(text)}")


def _on_one_line(text: str) -> str:
    sanitized = " ".join(remove_folders(escape_control_characters(text)).split()).rstrip(".: ")
    return shorten(sanitized or "it does not say why", _MAX_FAILURE_LENGTH)


def _find_misspelt_option(name: str) -> str | None:
    """Return the option of cornercase, such as ``timeout``, that the user probably meant by `name`; None for none."""
    if name.casefold() in _OWN_OPTIONS:
        return name.casefold()
    close = difflib.get_close_matches(name, _OWN_OPTIONS, n=1, cutoff=_MISSPELT)
    # A prefix such as ``start_time`` is an option of the program, not a misspelt ``start_timeout``.
    return close[0] if close and not close[0].startswith(name) else None


def _split_options(text: str) -> tuple[str, dict[str, Any]]:
    """Split a text into command and options: the part after the last colon, if its first item is ``name=value``.

    The part belongs to the command if an item that is not ``name=value`` has several words.
    """
    command, colon, ending = text.rpartition(":")
    items = [item.strip() for item in ending.split(",")]
    pairs = [item.partition("=") for item in items]
    bad = [
        item
        for item, (name, equals, _) in zip(items, pairs, strict=True)
        if not (name.strip().isidentifier() and equals)
    ]
    # An argument of the command may have a colon and commas, too.
    if not colon or items[0] in bad or any(len(item.split()) > 1 for item in bad):
        return text.strip(), {}
    if bad:
        raise InputError(
            f"The driver 'exec:{text}' has the option '{bad[0]}' without a name or value; give options as in"
            f" 'exec:{command}:name=value'."
        )
    options: dict[str, Any] = {}
    for name, _, value in pairs:
        if name.strip() in options:
            raise InputError(f"The driver 'exec:{text}' has the option '{name.strip()}' twice; give it once.")
        options[name.strip()] = _parse_value(value.strip())
    return command.strip(), options


def _parse_value(text: str) -> bool | float | str:
    if text in ("true", "false"):
        return text == "true"
    try:
        number = float(text)
    except ValueError:
        return text
    if not math.isfinite(number):
        return text
    return int(number) if number.is_integer() and text.lstrip("+-").isdecimal() else number


def _hash_command_files(words: list[str]) -> dict[str, str]:
    """Return ``{"sha256": …}`` with one checksum of all files that a command names, or else of its program.

    Returns an empty dict if no file is found.
    """
    paths = [path for word in words if (path := Path(word.rpartition("=")[2])).is_file()]
    # If no word is a file, the program is found by PATH.
    paths = paths or [Path(program) for word in words[:1] if (program := shutil.which(word)) is not None]
    digests = [hashlib.sha256(path.read_bytes()).hexdigest() for path in paths]
    if len(digests) > 1:
        return {"sha256": hashlib.sha256("".join(digests).encode()).hexdigest()}
    return {"sha256": digests[0]} if digests else {}
