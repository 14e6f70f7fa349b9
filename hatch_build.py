"""Build hook: compile the kernels for a wheel, if the environment variable CORNERCASE_COMPILE is set.

Such a wheel is for one version of Python on one platform, and saves its users the first minute of compiling. Without
the variable, a wheel is for all, and nothing but hatchling is needed to build it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# Prints for which levels of its processor this machine can compile.
LEVELS = "from cornercase._common.numba.shipped import list_runnable_cpu_levels; print(*list_runnable_cpu_levels())"


class CompileKernels(BuildHookInterface[Any]):
    """Adds machine code to a wheel."""

    def dependencies(self) -> list[str]:
        """Return what compiling needs: what the package needs."""
        return list(self.metadata.core.dependencies) if self._is_wanted() else []

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Compile, and add the results."""
        if not self._is_wanted() or version == "editable":
            return
        self._folder = tempfile.TemporaryDirectory()
        for level in self._run("-c", LEVELS).split():
            folder = Path(self._folder.name, level)
            folder.mkdir()
            with tempfile.TemporaryDirectory() as cache:
                self._run(
                    "-m", "cornercase", "warm-up", CORNERCASE_SHIP=str(folder), NUMBA_CACHE_DIR=cache,
                    NUMBA_CPU_NAME=level, NUMBA_CPU_FEATURES="",
                )  # fmt: skip
            build_data["force_include"][str(folder)] = f"cornercase/_compiled/{level}"
        python = f"cp{sys.version_info.major}{sys.version_info.minor}"
        # The code refers only to symbols that Python and numba have loaded.
        platform = sysconfig.get_platform().replace("linux-", "manylinux_2_17_")
        build_data["pure_python"] = False
        build_data["tag"] = "-".join((python, python, platform.replace("-", "_").replace(".", "_")))

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove what the wheel holds now."""
        if hasattr(self, "_folder"):
            self._folder.cleanup()

    def _is_wanted(self) -> bool:
        return self.target_name == "wheel" and bool(os.environ.get("CORNERCASE_COMPILE"))

    def _run(self, *arguments: str, **variables: str) -> str:
        environment = {**os.environ, "PYTHONPATH": str(Path(self.root, "src")), **variables}
        command = [sys.executable, *arguments]
        return subprocess.run(command, env=environment, check=True, stdout=subprocess.PIPE, text=True).stdout
