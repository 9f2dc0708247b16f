"""Adapters: the scheme of an address names an entry point of the group `masking.plants`, in this package or another.

An entry point leads to a callable that takes the address and returns a `Plant`, as a class does. One whose plant can be
reached from outside has a `listen` beside, which `masking.lab.plants.serve` uses.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Final, NoReturn, cast

from masking.errors import MaskingError, PlantError, PlantMismatchError
from masking.lab.plants.address import scheme_of
from masking.lab.plants.authentication import Key
from masking.lab.plants.interface import Plant
from masking.lab.plants.remote import RemotePlant
from masking.lab.plants.transport import Hub

GROUP: Final = "masking.plants"


def connect(address: str, key: Key | None = None) -> Plant:
    """Plant at an address such as `udp://127.0.0.1:5005`; nothing is reached before it is configured.

    `key` is that which its server has, too. A PlantMismatchError where no adapter has this scheme, its library is
    missing, the address is wrong, or a key is given where there are no frames; a PlantError where the adapter fails.
    """
    with _adapter(address) as adapter:
        if key is None:
            return cast(Plant, adapter(address))
        if not (isinstance(adapter, type) and issubclass(adapter, RemotePlant)):
            raise PlantMismatchError(f"{address} has no frames that a key could stand for; leave out --key")
        return adapter(address, key=key)


def listen(address: str) -> Hub:
    """Line at which a plant is served; raises what `connect` does, also where none is served at such addresses."""
    with _adapter(address) as adapter:
        if not callable(getattr(adapter, "listen", None)):
            raise PlantMismatchError(f"{address} cannot be served at; use udp://127.0.0.1:5005 or serial:pty")
        return cast(Hub, adapter.listen(address))


def schemes() -> tuple[str, ...]:
    """Schemes of all adapters that are installed, in the order of the alphabet."""
    return tuple(sorted(entry_points(group=GROUP).names))


@contextmanager
def _adapter(address: str) -> Iterator[Any]:
    """What the entry point of an address leads to; what goes wrong with it is in our words."""
    entry = _entry(address)
    try:
        yield entry.load()
    except MaskingError:
        raise
    except ImportError as error:
        _lacks(entry, error)
    except Exception as error:
        raise PlantError(f"{address}: the adapter {entry.value} failed: {type(error).__name__}: {error}") from error


def _entry(address: str) -> EntryPoint:
    scheme = scheme_of(address)
    if not scheme:
        known = ", ".join(f"{name}:" for name in schemes())
        remedy = f"write it as udp://127.0.0.1:5005, or with another scheme that is installed: {known}"
        raise PlantMismatchError(f"'{address}' is no address of a plant; {remedy}")
    found = {entry.value: entry for entry in entry_points(group=GROUP, name=scheme)}
    if not found:
        known = ", ".join(schemes()) or "none: install masking itself anew"
        remedy = f"install the package that has it; there are {known}"
        raise PlantMismatchError(f"{address}: no adapter has the scheme '{scheme}'; {remedy}")
    if len(found) > 1:
        both = " and ".join(f"{value} of {_package(entry)}" for value, entry in found.items())
        raise PlantMismatchError(f"{address}: {both} are adapters with the scheme '{scheme}'; uninstall one")
    return next(iter(found.values()))


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else "an unknown package"


def _lacks(entry: EntryPoint, error: ImportError) -> NoReturn:
    """Say which library an adapter needs, and the extra that brings it where the package has one of that name."""
    extras = entry.dist.metadata.get_all("Provides-Extra") or [] if entry.dist is not None else []
    package = _package(entry)
    remedy = f"pip install '{package}[{entry.name}]'" if entry.name in extras else "install what it needs"
    raise PlantMismatchError(f"{entry.name}: the adapter of {package} cannot be loaded ({error}); {remedy}") from error
