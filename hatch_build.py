"""Build hook of the wheel, which brings along what numba makes of the kernels: a first run then waits for LLVM alone.

    python hatch_build.py FOLDER

The kernels are those of the packaged experiments and of a discovery. They take minutes, so that `make dist` alone asks
for them; a wheel without them works, and each user's numba makes them once.
"""
# ruff: noqa: PLC0415
# Whatever builds the package reads this file, also where nothing but hatchling is installed.

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

ROOT = Path(__file__).parent


class KernelsHook(BuildHookInterface[Any]):
    """Adds the kernels to a wheel."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Make the kernels in a process of its own, and include their folder."""
        self.made = tempfile.TemporaryDirectory(prefix="masking-kernels-")
        cache, kernels = (str(Path(self.made.name, name)) for name in ("cache", "kernels"))
        subprocess.run(  # noqa: S603  # this file itself
            [sys.executable, __file__, kernels],
            env={**os.environ, "PYTHONPATH": str(ROOT), "MASKING_CACHE": cache},
            cwd=self.made.name,
            check=True,
        )
        build_data["force_include"][kernels] = "masking/shipped/kernels"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the folder."""
        self.made.cleanup()


def main() -> None:
    """Write the kernels into a folder."""
    from masking.compile.codegen import module_store

    folder = Path(sys.argv[1])
    folder.mkdir(parents=True)
    _use()
    for generated in module_store.kept():
        for name, kernel in generated.kernels.items():
            (folder / module_store.bitcode_name(kernel["content"])).write_bytes(generated.bitcode(name))


def _use() -> None:
    """Make the modules of the packaged experiments, and those of a discovery."""
    import masking
    from masking.lab.runs.experiment import Experiment
    from masking.model.declaration import catalogue

    for name in catalogue.names("experiment"):
        experiment = Experiment.load(name)
        _ = experiment.virtual.kernels, experiment.twin.kernels
        _ = experiment.sampled_loop.kernels if experiment.has_observer else experiment.loop.kernels
    recording = Experiment.load("cart_van_der_pol").changed(duration=20.0).run()
    recording.save("record")
    masking.discover("record", plant="cart")


if __name__ == "__main__":
    main()
