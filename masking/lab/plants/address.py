"""Address of a plant: `SCHEME:PLACE?OPTION=VALUE&...`, such as `serial:///dev/ttyACM0?baud=115200`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, final
from urllib.parse import unquote

from masking.errors import PlantMismatchError, nearest

_FORM: Final = re.compile(r"([A-Za-z][A-Za-z0-9.+-]+):(?://)?([^?]*)(?:\?(.*))?", re.DOTALL)


@final
@dataclass(frozen=True, slots=True)
class Address:
    """An address in its parts."""

    text: str  # as it was given
    scheme: str  # names the adapter, in lower case
    place: str  # what stands between the scheme, with `//` or without, and the options
    options: Mapping[str, str]  # values by name

    def number(self, name: str, default: float) -> float:
        """Positive option; a PlantMismatchError where it is none."""
        text = self.options.get(name, "")
        try:
            value = float(text) if text else default
        except ValueError:
            value = 0.0
        if not 0.0 < value < float("inf"):
            raise PlantMismatchError(f"{self.text}: {name} is '{text}'; give a positive number")
        return value

    def channels(self, name: str, there: Sequence[str], default: Iterable[str]) -> dict[str, str]:
        """Channels of an option, such as `x:position,v`, in its order: by name, what the plant calls each.

        The plant has those that are `there`, empty where only the hardware knows; `default` is taken where the option
        is not given. A PlantMismatchError where a name is not there or stands twice, or there is none.
        """
        found: dict[str, str] = {}
        given = [part.strip() for part in self.options[name].split(",")] if name in self.options else list(default)
        for channel, _, own in (part.partition(":") for part in given):
            if not channel or channel in found:
                remedy = "write them as a,b or as name:a,other:b" if not channel else "let each name stand once"
                names = self.options.get(name, ",".join(given))
                raise PlantMismatchError(f"{self.text}: {name} are '{names}'; {remedy}")
            found[channel] = own or channel
            if there and found[channel] not in there:
                remedy = nearest(found[channel], there)
                raise PlantMismatchError(f"{self.text}: there is no '{found[channel]}' for {name}; {remedy}")
        if not found:
            raise PlantMismatchError(f"{self.text}: it has no {name}; name some with ?{name}=a,b")
        return found


def parse(text: str, allowed: Iterable[str] = (), form: str = "udp://127.0.0.1:5005") -> Address:
    """Split an address, whose options have `allowed` names; a PlantMismatchError, which shows `form`, for any other."""
    found = _FORM.fullmatch(text)
    if found is None or not found[2]:
        raise PlantMismatchError(f"'{text}' is no address of a plant; write it as {form}")
    options: dict[str, str] = {}
    names = list(allowed)
    for part in filter(None, (found[3] or "").split("&")):
        name, _, value = part.partition("=")
        if name not in names or name in options:
            remedy = "give it once" if name in options else nearest(name, names)
            raise PlantMismatchError(f"{text}: '{name}' is no option of this address; {remedy}")
        options[name] = unquote(value)
    return Address(text, found[1].lower(), unquote(found[2]), options)


def scheme_of(text: str) -> str:
    """Scheme of an address; empty where the text is none."""
    found = _FORM.fullmatch(text)
    return found[1].lower() if found is not None else ""
