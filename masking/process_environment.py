"""Environment of the processes that this program starts: made of what they need, without the current folder.

Whoever writes a file into the folder that a run is started in must not thereby run code in it. A variable of a library
that a plant's own adapter brings reaches the processes of a batch if its name begins with `MASKING_`.
"""

from __future__ import annotations

import os
import site
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Final

_PASSED: Final = (
    *("HOME", "USER", "LOGNAME", "TMPDIR", "TEMP", "TMP", "TZ", "LANG", "LANGUAGE", "LC_*", "XDG_*", "MASKING_*"),
    *("OMP_*", "KMP_*", "MKL_*", "OPENBLAS_*", "BLIS_*", "VECLIB_*", "NUMBA_*"),  # threads and processors
    *("DISPLAY", "WAYLAND_DISPLAY", "XAUTHORITY", "MPLBACKEND", "MPLCONFIGDIR", "MUJOCO_*", "*_LICENSE_FILE"),
    *("PYTHONHOME", "PYTHONUSERBASE", "PYTHONNOUSERSITE", "PYTHONUTF8", "PYTHONHASHSEED"),
    *("PYTHONDONTWRITEBYTECODE", "PYTHONPYCACHEPREFIX"),
    *("SYSTEMROOT", "SYSTEMDRIVE", "WINDIR", "COMSPEC", "PATHEXT", "USERPROFILE", "USERNAME", "APPDATA"),
    *("LOCALAPPDATA", "PROGRAMDATA", "PROGRAMFILES*", "NUMBER_OF_PROCESSORS", "PROCESSOR_*"),
)
_FOLDERS: Final = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH")  # lists, of which the absolute ones are passed
_SEARCHED: Final = "PYTHONPATH"
_ROOT: Final = Path(__file__).resolve().parents[1]  # the folder that this package is in


def minimal(given: Mapping[str, str] = os.environ) -> dict[str, str]:
    """Environment for another process, from that of this one; a Python in it finds the same package as this one."""
    made = {name: value for name, value in given.items() if any(fnmatchcase(name, one) for one in _PASSED)}
    folders = {name: _absolute(given[name]) for name in _FOLDERS if name in given}
    is_installed = any(Path(one).resolve() == _ROOT for one in (*site.getsitepackages(), site.getusersitepackages()))
    own = [] if is_installed else [str(_ROOT)]  # else its packages would come before the standard library
    folders[_SEARCHED] = list(dict.fromkeys([*own, *_absolute(given.get(_SEARCHED, ""))]))
    return made | {name: os.pathsep.join(several) for name, several in folders.items() if several}


@contextmanager
def safe_start() -> Iterator[None]:
    """Context in which processes of `multiprocessing`, which inherit the environment, get the minimal one."""
    before, made = dict(os.environ), minimal() | {"PYTHONSAFEPATH": "1"}
    _replace(made)
    try:
        yield
    finally:
        _replace(before)


def _replace(variables: Mapping[str, str]) -> None:
    for name in os.environ.keys() - variables.keys():
        del os.environ[name]
    os.environ.update({name: value for name, value in variables.items() if os.environ.get(name) != value})


def _absolute(text: str) -> list[str]:
    """Folders of a list that do not depend on the current one, as an empty one does."""
    return [folder for folder in text.split(os.pathsep) if Path(folder).is_absolute()]
