"""SUMO's network of a scenario's roads."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.files import read_file, written_whole
from cornercase._common.platform import find_program, user_cache
from cornercase.scenario import Scenario, Value, parse_xml

_PATIENCE: Final = 120.0


def sumo_network(scenario: Scenario, given: str | None = None, values: Mapping[str, Value] | None = None) -> Path:
    """Find or make the network of a scenario: the one that is given, or netconvert's of the OpenDRIVE file.

    What was converted is kept in the user's cache, under the hash of the OpenDRIVE file.

    Parameters
    ----------
    scenario : Scenario
    given : str, optional
        A ``.net.xml`` in the coordinates of the scenario.
    values : mapping of str to float or str, optional
        Of its parameters, one of which may name the roads.

    Returns
    -------
    Path
        Of the ``.net.xml``.

    Raises
    ------
    InputError
        There is no such file, the scenario has no road network, or netconvert is missing or cannot convert it.
    """
    if given is not None:
        if not Path(given).is_file():
            raise InputError(f"{given}: there is no such network file; give a .net.xml.")
        return Path(given)
    roads = scenario.road_file(values)
    if roads is None:
        raise InputError(f"{scenario.path}: has no road network in <RoadNetwork><LogicFile>, which SUMO needs.")
    if roads.name.endswith(".net.xml"):
        raise InputError(
            f"{scenario.path}: names SUMO's network {roads.name} as its roads, where positions on roads need OpenDRIVE;"
            " name an OpenDRIVE file there, and give the network by `simulator` sumo:network=FILE."
        )
    content = read_file(roads)
    key = hashlib.sha256(content).hexdigest()[:32]
    cached = user_cache() / "cornercase" / "sumo" / f"{key}.net.xml"
    if not cached.exists():
        with written_whole(cached) as temporary:
            _convert(roads, content, temporary)
    return cached


def _convert(roads: Path, content: bytes, target: Path) -> None:
    program = _netconvert()
    # netconvert would resolve the entities of a document type: it gets only what is refused nowhere else.
    try:
        parse_xml(content, roads)
    except InputError as error:
        raise InputError(f"{roads}: netconvert cannot convert it ({error}).") from error
    # netconvert recognises the format by the ending of the name.
    with tempfile.TemporaryDirectory() as folder:
        # A name of ours, since it takes commas for the end of a name.
        given, written = Path(folder) / "roads.xodr", Path(folder) / "roads.net.xml"
        given.write_bytes(content)
        command = [program, "--opendrive", str(given), "--output-file", str(written)]
        command += ["--offset.disable-normalization", "true", "--xml-validation", "never"]
        try:
            # It looks for data of its projections in the current folder, too.
            done = subprocess.run(command, capture_output=True, timeout=_PATIENCE, check=False, cwd=folder)
        except subprocess.TimeoutExpired:
            raise InputError(f"{roads}: netconvert did not convert it within {_PATIENCE:g} s.") from None
        if done.returncode != 0 or not written.exists():
            said = done.stderr.decode("utf-8", "replace").splitlines()
            lines = [line for line in said if "rror" in line] or said or ["?"]
            raise InputError(f"{roads}: netconvert cannot convert it ({lines[0].strip()}).")
        target.write_bytes(written.read_bytes())


def _netconvert() -> str:
    found = find_program("netconvert")
    if found is None and find_spec("sumo") is not None:
        import sumo

        found = find_program("netconvert", [str(Path(sumo.SUMO_HOME) / "bin")])
    if found is None:
        raise InputError(
            "netconvert, which makes SUMO's network from OpenDRIVE, is missing; pip install 'cornercase[sumo]'."
        )
    return found
