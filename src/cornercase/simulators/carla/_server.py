"""A CARLA server and the client connected to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.io.files import read_file

_LOAD_TIMEOUT: Final = 120.0
_MESH_OPTIONS: Final = {"vertex_distance": 2.0, "wall_height": 1.0, "additional_width": 0.6}


class CarlaServer:
    """A CARLA server that no other program uses; `patience` is the time in s to wait for an answer."""

    def __init__(self, host: str, port: int, patience: float) -> None:
        self.host, self.port, self.patience = host, port, patience
        self._client: Any = None

    def get_client(self) -> Any:
        """Return the client, created at first use; `InputError` if no server of its version answers."""
        if self._client is None:
            import carla

            client = carla.Client(self.host, self.port)
            client.set_timeout(self.patience)
            try:
                client_version, server_version = client.get_client_version(), client.get_server_version()
            except RuntimeError as error:
                raise InputError(
                    f"No CARLA answers on {self.host}:{self.port} ({error}); start CarlaUE4.sh"
                    f" -carla-rpc-port={self.port}."
                ) from error
            if client_version != server_version:
                raise InputError(
                    f"CARLA on {self.host}:{self.port} has version {server_version}, the client here {client_version};"
                    f" start CARLA {client_version}."
                )
            self._client = client
        return self._client

    def reset_client(self) -> None:
        """Create a new client at the next use, since the server may have been restarted."""
        self._client = None

    def prepare_map(self, road: Path | str | None) -> None:
        """Load a map (OpenDRIVE file or name of a CARLA map) unless it is loaded, and remove actors of earlier runs."""
        import carla

        client = self.get_client()
        world = client.get_world()
        if isinstance(road, Path):
            text = _strip_before_root(read_file(road).decode(errors="replace"))
            if _strip_before_root(world.get_map().to_opendrive()) != text:
                # The same mesh as ScenarioRunner's, so that it finds its map loaded.
                mesh = carla.OpendriveGenerationParameters(
                    **_MESH_OPTIONS, smooth_junctions=True, enable_mesh_visibility=True
                )
                client.set_timeout(_LOAD_TIMEOUT)
                world = client.generate_opendrive_world(text, mesh)
        elif road is not None and world.get_map().name.rpartition("/")[2] != road:
            client.set_timeout(_LOAD_TIMEOUT)
            world = client.load_world(road)
        client.set_timeout(self.patience)
        self.leave_synchronous_mode()
        for actor in world.get_actors():
            if actor.type_id.startswith(("vehicle.", "walker.", "sensor.", "controller.")):
                actor.destroy()

    def leave_synchronous_mode(self) -> None:
        """Leave synchronous mode, in which the server would wait for ticks that no client sends any more."""
        world = self.get_client().get_world()
        settings = world.get_settings()
        if settings.synchronous_mode:
            settings.synchronous_mode, settings.fixed_delta_seconds = False, None
            world.apply_settings(settings)

    def stop_recorder(self) -> None:
        """Stop CARLA's recorder, so that it closes its file."""
        client = self.get_client()
        client.stop_recorder()
        # The server answers this only after it has closed the file.
        client.get_world().get_settings()


def _strip_before_root(text: str) -> str:
    return text[text.find("<OpenDRIVE") :]
