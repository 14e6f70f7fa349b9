"""A CARLA server, and the client by which cornercase prepares and observes it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError, SimulatorError
from cornercase.simulators.carla._client_process import ClientError, ClientProcess
from cornercase.simulators.carla._runner_environment import RunnerEnvironment

_LOAD_TIMEOUT: Final = 120.0
# ScenarioRunner takes any mesh of the same road file. Walls would stand where walkers go.
_MESH: Final = {
    "vertex_distance": 2.0, "wall_height": 0.0, "additional_width": 0.6, "smooth_junctions": True,
    "enable_mesh_visibility": True,
}  # fmt: skip


class CarlaServer:
    """A CARLA server that no other program uses.

    `patience`: time in s to wait for an answer. `any_version`: whether server, client and ScenarioRunner may have
    different versions. `renders`: whether the server draws pictures.
    """

    def __init__(
        self, host: str, port: int, patience: float, *, any_version: bool = False, renders: bool = True
    ) -> None:
        self.host, self.port, self.patience, self._renders = host, port, patience, renders
        self._any_version = any_version
        self._client: ClientProcess | None = None

    def connect(self, environment: RunnerEnvironment, *, has_answered: bool = False) -> None:
        """Start the client unless it runs, and connect it to the server.

        Raises `InputError` if no server answers, or, without `any_version`, if the versions of server, client and
        ScenarioRunner differ. If the server has answered shortly before (`has_answered`) and answers no longer, a
        `SimulatorError` is raised instead.
        """
        if self._client is not None:
            return
        self._client = client = ClientProcess(environment)
        try:
            try:
                versions = client.call_method("connect", self.host, self.port, self.patience)
            except ClientError as error:
                if has_answered:
                    raise SimulatorError(f"CARLA on {self._address} answers no longer: {error}") from error
                raise InputError(
                    f"No CARLA answers on {self._address} ({error}); start CarlaUE4.sh -carla-rpc-port={self.port}."
                ) from error
            if not self._any_version:
                client_version, server_version = versions
                environment.check_versions(client_version, server_version, self._address)
        except (InputError, SimulatorError):
            self.disconnect()
            raise

    def disconnect(self) -> None:
        """End the client; `connect` starts a new one."""
        if self._client is not None:
            self._client.close()
        self._client = None

    @property
    def is_connected(self) -> bool:
        """True if the client runs."""
        return self._client is not None

    def prepare(self, town: str, road: str, *, keep: str = "") -> None:
        """Load a map of CARLA or a road file, and remove the actors of earlier runs.

        `town`: name of CARLA's map, or empty. `road`: text of the road file, or empty. `keep`: role name of an actor
        that stays. Raises `InputError` if the server has no map of this name.
        """
        if available := self._call_client("load_map", town, road, _MESH, _LOAD_TIMEOUT, self.patience):
            raise InputError(
                f"CARLA on {self._address} has no map '{town}', only {', '.join(available)}; install it there, or name"
                " a road file."
            )
        self._call_client("leave_synchronous_mode", self._renders)
        self._call_client("remove_actors", keep)

    def leave_synchronous_mode(self) -> None:
        """Leave synchronous mode, in which the server would wait for ticks; does nothing without a client."""
        if self._client is not None:
            self._call_client("leave_synchronous_mode")

    def start_recorder(self, path: Path) -> None:
        """Let CARLA's recorder write a recording into a file on the server's machine."""
        self._call_client("start_recorder", str(path))

    def stop_recorder(self) -> None:
        """Stop CARLA's recorder, so that it closes its file."""
        self._call_client("stop_recorder")

    def track(self, names: Sequence[str], external: str) -> None:
        """Begin to record the actors with these role names; only the actor `external` may exist already."""
        self._call_client("track", list(names), external)

    def poll(self) -> dict[str, Any]:
        """Return the frames, contacts and entities that were recorded since the last call."""
        result: dict[str, Any] = self._call_client("poll")
        return result

    def end_tracking(self) -> None:
        """Remove the sensors, and stop recording."""
        self._call_client("end_tracking")

    @property
    def _address(self) -> str:
        return f"{self.host}:{self.port}"

    def _call_client(self, method: str, *arguments: object) -> Any:
        if self._client is None:
            raise SimulatorError(f"CARLA on {self._address} is gone")
        try:
            return self._client.call_method(method, *arguments)
        except ClientError as error:
            raise SimulatorError(f"CARLA on {self._address}: {error}") from error
