"""FMUs for tests, compiled from C."""

from __future__ import annotations

import atexit
import functools
import shutil
import subprocess
import tempfile
import zipfile
from collections.abc import Mapping
from ctypes import c_double
from pathlib import Path

import fmpy
import pytest

from cornercase.drivers.fmu._instance import Instance

SOURCES = Path(__file__).parents[1] / "data" / "fmu"
HEADERS = Path(fmpy.__file__).parent / "c-code"
COMPILER = shutil.which("cc") or shutil.which("gcc")
# Name, causality, value reference, start value, unit.
REALS = {
    "v_ego": ("input", 0, "0", "m/s"),
    "gap": ("input", 1, "1000", "m"),
    "closing": ("input", 2, "0", "m/s"),
    "reaction": ("parameter", 3, "0.1", "s"),
    "threshold": ("parameter", 4, "2", "s"),
    "fault_time": ("parameter", 5, "1", "s"),
    "acceleration": ("output", 6, None, "m/s2"),
}
UNITS = """
  <UnitDefinitions>
    <Unit name="m/s"><BaseUnit m="1" s="-1"/></Unit>
    <Unit name="speed"><BaseUnit m="1" s="-1" factor="0.2777777777777778"/></Unit>
    <Unit name="kg"><BaseUnit kg="1"/></Unit>
  </UnitDefinitions>"""
LOGGING = """
  <LogCategories><Category name="logStatusError"/></LogCategories>"""


@functools.cache
def _library(source: str, *definitions: str) -> Path:
    if COMPILER is None:
        pytest.skip("there is no C compiler")
    folder = Path(tempfile.mkdtemp(prefix="cornercase-tests-fmu-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    built = folder / "built.so"
    command = [COMPILER, "-O1", "-shared", "-fPIC", "-w", *definitions, f"-I{HEADERS}", str(SOURCES / source)]
    subprocess.run([*command, "-o", str(built), "-lm"], check=True)
    return built


def make_fmu(
    path: Path,
    fmi: int = 2,
    *,
    once: bool = False,
    rename: Mapping[str, str] | None = None,
    units: Mapping[str, str] | None = None,
    step_size: float | None = None,
    library: bool = True,
) -> Path:
    """Write the FMU of ``tests/data/fmu/aeb.c``, with other names and units of its variables if wanted."""
    names, given = dict(rename or {}), dict(units or {})
    variables = []
    for name, (causality, reference, start, unit) in REALS.items():
        shown, unit = names.get(name, name), given.get(name, unit)
        head = f'name="{shown}" valueReference="{reference}" causality="{causality}"'
        tail = (f' unit="{unit}"' if unit else "") + ("" if start is None else f' start="{start}"')
        variability = ' variability="fixed"' if causality == "parameter" else ""
        variables.append(
            f"<ScalarVariable {head}{variability}><Real{tail}/></ScalarVariable>"
            if fmi == 2
            else f"<Float64 {head}{variability}{tail}/>"
        )
    head = 'name="fault" valueReference="20" causality="parameter" variability="fixed"'
    variables.append(
        f'<ScalarVariable {head}><Integer start="0"/></ScalarVariable>' if fmi == 2 else f'<Int32 {head} start="0"/>'
    )
    attributes = ' canBeInstantiatedOnlyOncePerProcess="true"' if once else ""
    token = 'guid="{aeb}"' if fmi == 2 else 'instantiationToken="{aeb}"'
    experiment = "" if step_size is None else f'\n  <DefaultExperiment stepSize="{step_size}"/>'
    text = f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="{fmi}.0" modelName="Emergency brake" {token}>
  <CoSimulation modelIdentifier="aeb"{attributes}/>{UNITS}{LOGGING}{experiment}
  <ModelVariables>{"".join(variables)}</ModelVariables>
  <ModelStructure/>
</fmiModelDescription>"""
    platform = fmpy.platform if fmi == 2 else fmpy.platform_tuple
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        if library:
            built = _library("aeb.c", f"-DFMI={fmi}", *(["-DONCE"] if once else []))
            archive.write(built, f"binaries/{platform}/aeb{fmpy.sharedLibraryExtension}")
    return path


def make_steering_fmu(path: Path) -> Path:
    """Write the FMU of ``tests/data/fmu/pursuit.c``, which steers towards the point of its path 6 m ahead."""
    names = ("path[6].x", "path[6].y", "ego.wheelbase", "acceleration", "steering")
    units = ("m", "m", "m", "m/s2", "rad")
    variables = "".join(
        f'<ScalarVariable name="{name}" valueReference="{k}" causality="{causality}"><Real unit="{unit}"{start}/>'
        "</ScalarVariable>"
        for k, (name, unit) in enumerate(zip(names, units, strict=True))
        for causality, start in ((("input", ' start="0"') if k < 3 else ("output", "")),)
    )
    text = f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="Pursuit" guid="{{pursuit}}" variableNamingConvention="structured">
  <CoSimulation modelIdentifier="pursuit"/>
  <ModelVariables>{variables}</ModelVariables>
  <ModelStructure/>
</fmiModelDescription>"""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(_library("pursuit.c"), f"binaries/{fmpy.platform}/pursuit{fmpy.sharedLibraryExtension}")
    return path


def message_variables(name: str, message: str, causality: str, reference: int) -> str:
    """The three variables of a message by OSMP."""
    kind = f"application/x-open-simulation-interface; type={message}; version=3.8.0"
    varies = f'variability="{"fixed" if "arameter" in causality else "discrete"}"'
    start = '<Integer start="0"/>' if causality in ("input", "parameter") else "<Integer/>"
    return "".join(
        f"""
    <ScalarVariable name="{name}.{role}" valueReference="{reference + k}" causality="{causality}" {varies}>
      {start}<Annotations><Tool name="net.pmsf.osmp" xmlns:osmp="http://xsd.pmsf.net/OSISensorModelPackaging">
        <osmp:osmp-binary-variable name="{name}" role="{role}" mime-type="{kind}"/></Tool></Annotations>
    </ScalarVariable>"""
        for k, role in enumerate(("base.lo", "base.hi", "size"))
    )


def make_osmp_fmu(
    path: Path,
    output: str = "OSMPTrafficUpdateOut",
    *,
    init: bool = True,
    variables: str | None = None,
    more: str = "",
    step_size: float | None = None,
    any_step: bool = False,
) -> Path:
    """Write the FMU of ``tests/data/fmu/osmp.c``; `variables` replace those of its messages, `more` precede them."""
    message = output.removeprefix("OSMP").partition("Out")[0]
    given = message_variables("OSMPSensorViewIn", "SensorView", "input", 0)
    given += message_variables("OSMPGroundTruthInit", "GroundTruth", "parameter", 3) if init else ""
    given += message_variables(output, message, "output", 6)
    fixed = 'variability="fixed"'
    attributes = ' canHandleVariableCommunicationStepSize="true"' if any_step else ""
    experiment = "" if step_size is None else f'\n  <DefaultExperiment stepSize="{step_size}"/>'
    text = f"""<?xml version="1.0"?>
<fmiModelDescription fmiVersion="2.0" modelName="Participant" guid="{{osmp}}" variableNamingConvention="structured">
  <CoSimulation modelIdentifier="osmp"{attributes}/>{LOGGING}{experiment}
  <VendorAnnotations><Tool name="net.pmsf.osmp" xmlns:osmp="http://xsd.pmsf.net/OSISensorModelPackaging">
    <osmp:osmp version="1.6.0" osi-version="3.8.0"/></Tool></VendorAnnotations>
  <ModelVariables>{more}{given if variables is None else variables}
    <ScalarVariable name="answer" valueReference="9" causality="parameter" {fixed}><Integer start="0"/></ScalarVariable>
    <ScalarVariable name="reaction" valueReference="0" causality="parameter" {fixed}><Real start="0.1"/></ScalarVariable>
    <ScalarVariable name="record" valueReference="0" causality="parameter" {fixed}><String start=""/></ScalarVariable>
  </ModelVariables>
  <ModelStructure/>
</fmiModelDescription>"""
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", text)
        archive.write(_library("osmp.c"), f"binaries/{fmpy.platform}/osmp{fmpy.sharedLibraryExtension}")
    return path


PYTHON_AEB = '''
from pythonfmu import Fmi2Causality, Fmi2Slave, Fmi2Variability, Real


class PythonAeb(Fmi2Slave):
    """As the one in C."""

    def __init__(self, **options):
        super().__init__(**options)
        self.ego_speed, self.gap, self.closing_speed = 0.0, 1000.0, 0.0
        self.reaction, self.acceleration = 0.1, 0.0
        self.since, self.braking = 0.0, False
        for name in ("ego_speed", "gap", "closing_speed"):
            self.register_variable(Real(name, causality=Fmi2Causality.input))
        self.register_variable(
            Real("reaction", causality=Fmi2Causality.parameter, variability=Fmi2Variability.tunable)
        )
        self.register_variable(Real("acceleration", causality=Fmi2Causality.output))

    def do_step(self, time, size):
        is_short = self.closing_speed > 0.0 and self.gap / self.closing_speed < 2.0
        self.since = self.since + size if is_short else 0.0
        self.braking = self.braking or self.since > self.reaction
        self.acceleration = -8.0 if self.braking else 0.0
        return True
'''


def make_python_fmu(folder: Path, code: str = PYTHON_AEB) -> Path:
    """Build an FMU with pythonfmu."""
    builder = pytest.importorskip("pythonfmu.builder")
    (folder / "python_aeb.py").write_text(code)
    return Path(builder.FmuBuilder.build_FMU(folder / "python_aeb.py", dest=folder))


def step_instance(instance: Instance, time: float, size: float) -> None:
    """Let an instance do one step of `size` s from a time in s."""
    instance.bind_step(c_double(time), size)()
