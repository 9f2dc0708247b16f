"""On Windows, which is not tested: without the modules that it does not have, everything is imported, and says so."""

import subprocess
import sys
from pathlib import Path

CODE = """
import pkgutil, platform, sys
for other in (
    "asyncio", "concurrent.futures.process", "ctypes.util", "multiprocessing.connection", "multiprocessing.forkserver",
    "multiprocessing.shared_memory", "fmpy", "h5py", "matplotlib.animation", "mujoco", "numba", "pandas",
    "pyarrow.parquet", "scipy.signal", "serial", "sympy",
):  # as they are here
    try:
        __import__(other)
    except ImportError:
        pass
hidden = ("fcntl", "grp", "pwd", "resource", "termios", "tty")
sys.modules.update(dict.fromkeys(hidden))
sys.platform, platform.system = "win32", lambda: "Windows"
import masking
from masking.app import cli

for found in pkgutil.walk_packages(masking.__path__, "masking."):
    if not found.name.endswith("__main__"):
        try:
            __import__(found.name)
        except ImportError as error:  # of a package that is not installed here
            if error.name in hidden:
                raise
print(cli.main(["rig", "batch", "examples/batches/huygens_starts.yaml", "--out", sys.argv[1]]))
"""


def test_every_module_is_imported_and_what_needs_another_system_names_it(tmp_path):
    given = [sys.executable, "-c", CODE, tmp_path / "out"]
    done = subprocess.run(given, check=False, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert done.stdout.split() == ["2"], done.stderr
    assert done.stderr.rstrip().endswith(
        "Windows has no lock that processes hand on, as a batch needs; run it on Linux"
    )
    assert not (tmp_path / "out").exists()
