"""A CARLA server, and the client to it."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from cornercase._common.errors import InputError
from cornercase._common.files import read_file

_LOADING: Final = 120.0
_MESH: Final = {"vertex_distance": 2.0, "wall_height": 1.0, "additional_width": 0.6}


class Server:
    """A CARLA server that nothing else uses.

    Parameters
    ----------
    host : str
    port : int
    patience : float
        s to wait for an answer.
    """

    def __init__(self, host: str, port: int, patience: float) -> None:
        self.host, self.port, self.patience = host, port, patience
        self._client: Any = None

    def client(self) -> Any:
        """Return the client to it, which is made when it is first asked for.

        Returns
        -------
        carla.Client

        Raises
        ------
        InputError
            Nobody answers, or a server of another version.
        """
        if self._client is None:
            import carla

            client = carla.Client(self.host, self.port)
            client.set_timeout(self.patience)
            try:
                ours, theirs = client.get_client_version(), client.get_server_version()
            except RuntimeError as error:
                raise InputError(
                    f"No CARLA answers on {self.host}:{self.port} ({error}); start CarlaUE4.sh"
                    f" -carla-rpc-port={self.port}."
                ) from error
            if ours != theirs:
                raise InputError(
                    f"CARLA on {self.host}:{self.port} is of version {theirs}, the client here of {ours}; start CARLA"
                    f" {ours}."
                )
            self._client = client
        return self._client

    def forget(self) -> None:
        """Take a new client the next time, as the server may have been started anew."""
        self._client = None

    def prepare(self, road: Path | str | None) -> None:
        """Load a map where another one is there, and clear away what an earlier run has left.

        Parameters
        ----------
        road : Path, str or None
            OpenDRIVE file, or the name of one of CARLA's maps.
        """
        import carla

        client = self.client()
        world = client.get_world()
        if isinstance(road, Path):
            text = _opendrive(read_file(road).decode(errors="replace"))
            if _opendrive(world.get_map().to_opendrive()) != text:
                # The mesh that ScenarioRunner would make, so that it finds its map loaded.
                mesh = carla.OpendriveGenerationParameters(**_MESH, smooth_junctions=True, enable_mesh_visibility=True)
                client.set_timeout(_LOADING)
                world = client.generate_opendrive_world(text, mesh)
        elif road is not None and world.get_map().name.rpartition("/")[2] != road:
            client.set_timeout(_LOADING)
            world = client.load_world(road)
        client.set_timeout(self.patience)
        self.calm()
        for actor in world.get_actors():
            if actor.type_id.startswith(("vehicle.", "walker.", "sensor.", "controller.")):
                actor.destroy()

    def calm(self) -> None:
        """Let the server run at its own pace again, since nobody sends it ticks any more."""
        world = self.client().get_world()
        settings = world.get_settings()
        if settings.synchronous_mode:
            settings.synchronous_mode, settings.fixed_delta_seconds = False, None
            world.apply_settings(settings)

    def end_recording(self) -> None:
        """Let it close its recorder's file."""
        client = self.client()
        client.stop_recorder()
        # The server answers this only after it has closed the file.
        client.get_world().get_settings()


def _opendrive(text: str) -> str:
    """Without what stands before the root element."""
    return text[text.find("<OpenDRIVE") :]
