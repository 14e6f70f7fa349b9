"""SUMO's road network of a scenario, converted from OpenDRIVE if necessary."""

from __future__ import annotations

import hashlib
import subprocess
import tempfile
from collections.abc import Mapping
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Final

from cornercase._common.errors import InputError
from cornercase._common.io.files import atomic_write, read_file
from cornercase._common.optional_packages import describe_install
from cornercase._common.platform import find_program, user_cache_folder
from cornercase.scenario import Value
from cornercase.scenario._file import ScenarioFile
from cornercase.scenario._xml import parse_xml

_CONVERSION_TIMEOUT: Final = 120.0


def find_or_convert_network(
    scenario: ScenarioFile, network_file: str | None = None, values: Mapping[str, Value] | None = None
) -> Path:
    """Return a scenario's SUMO network: `network_file`, or else a network converted from OpenDRIVE.

    The converted network is cached by the checksum of the OpenDRIVE file and the version of SUMO.
    """
    if network_file is not None:
        if not Path(network_file).is_file():
            raise InputError(f"{network_file}: there is no such network file; give a .net.xml file.")
        return Path(network_file)
    roads = scenario.road_path_for(values)
    if roads is None:
        raise InputError(f"{scenario.path}: has no road network in <RoadNetwork><LogicFile>, which SUMO needs.")
    if roads.name.endswith(".net.xml"):
        raise InputError(
            f"{scenario.path}: names SUMO's network {roads.name} as its roads, but positions on roads need OpenDRIVE;"
            " name an OpenDRIVE file in <LogicFile>, and give the network with `simulator` sumo:network=FILE."
        )
    content = read_file(roads)
    key = hashlib.sha256(content).hexdigest()[:32]
    cached = user_cache_folder() / "cornercase" / "sumo" / f"{key}-{version('libsumo')}.net.xml"
    if not cached.exists():
        with atomic_write(cached) as temporary:
            _convert_roads(roads, content, temporary)
    return cached


def _convert_roads(roads: Path, content: bytes, target: Path) -> None:
    program = _find_netconvert()
    # netconvert would resolve XML entities, so check the file with our own parser first.
    try:
        parse_xml(content, roads)
    except InputError as error:
        raise InputError(f"{roads}: netconvert cannot convert it ({error}).") from error
    # netconvert recognizes the format by the file extension.
    with tempfile.TemporaryDirectory() as folder:
        # Not the user's file name: netconvert splits names at commas.
        input_file, output_file = Path(folder) / "roads.xodr", Path(folder) / "roads.net.xml"
        input_file.write_bytes(content)
        command = [program, "--opendrive", str(input_file), "--output-file", str(output_file)]
        command += ["--offset.disable-normalization", "true", "--xml-validation", "never"]
        try:
            # It would also search the current folder for projection data.
            done = subprocess.run(command, capture_output=True, timeout=_CONVERSION_TIMEOUT, check=False, cwd=folder)
        except subprocess.TimeoutExpired:
            raise InputError(f"{roads}: netconvert did not convert it within {_CONVERSION_TIMEOUT:g} s.") from None
        if done.returncode != 0 or not output_file.exists():
            messages = done.stderr.decode("utf-8", "replace").splitlines()
            lines = [line for line in messages if "rror" in line] or messages or ["?"]
            raise InputError(f"{roads}: netconvert cannot convert it ({lines[0].strip()}).")
        target.write_bytes(output_file.read_bytes())


def _find_netconvert() -> str:
    program = find_program("netconvert")
    if program is None and find_spec("sumo") is not None:
        import sumo

        program = find_program("netconvert", [str(Path(sumo.SUMO_HOME) / "bin")])
    if program is None:
        raise InputError(
            f"netconvert, which converts OpenDRIVE to SUMO's network, is missing; {describe_install('sumo')}."
        )
    return program
