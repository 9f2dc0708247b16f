"""Make an actuated rig move as if it were another machine.

Four objects carry the package:

* `Model`: a declared system, its equations symbolic when looked at and compiled when run;
* `Controller`: the control law that makes one model move as another, in blocks L, D, G and T;
* `Plant`: a rig, simulated or real, declared in a plant file;
* `Recording`: the series of one run and the manifest that says what they are, in one folder on disk.

Each verb of the command line is a function here: `catalogue` (its `list`), `show`, `check`, `run`, `report`,
`recover`, `animate`, `compare`, `sweep`, `load_sweep`, `simulate`, `identify`, `measure`,
`calibrate`, `learn`, `discover`, `refine`, `stability`, `play`, `export`.

    >>> import masking
    >>> recording = masking.run("duffing")
    >>> max(recording.manifest["masking_error"].values()) < 1e-6
    True
"""

import sys

# `python -m masking` puts the current folder first on the path, where a file named as a module of the standard library
# would be run in its place. While Python looks for what it is to run, the name of the program is "-m".
if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:
    _module = sys.orig_argv[-len(sys.argv)].partition(".")[0]
    if _module in {__name__, f"-m{__name__}"} and sys.path[0] != __path__[0].removesuffix(__name__)[:-1]:
        del sys.path[0]

from typing import Any

import lazy_loader as lazy

# The names and their modules stand in `__init__.pyi`, which type checkers read too; each loads when it is used.
_loaded, __dir__, __all__ = lazy.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:  # noqa: ANN401
    if name == "__version__":
        from importlib.metadata import version  # noqa: PLC0415 - takes as long as all other imports here

        return version("masking")
    return _loaded(name)
