"""Measured response: frequency response and nonlinear distortion of a rig, from records of periodic excitation.

Records of one rig are experiments. With one input that moves, each is a realisation; with several, either every line
belongs to one input, or as many records as inputs tell them apart.
Source: Pintelon and Schoukens, System Identification: A Frequency Domain Approach (2012), chapters 2 to 4.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from masking.compile.numerics.arrays import Array
from masking.errors import RecordError
from masking.inference.estimation.periodic_spectra import Spectra, repeats
from masking.inference.procedures import frequency_response as responses
from masking.inference.procedures.channel_names import Channel, Source
from masking.inference.procedures.frequency_response import Distortion, FrequencyResponse
from masking.inference.procedures.measurement import LEVEL, Measurement, Row
from masking.model.declaration.quantities import percent

REPEATED = 0.1  # of their size: commands differ by less from period to period


@dataclass(frozen=True)
class Response:
    """Frequency responses, and distortions where the excitation leaves lines free."""

    inputs: tuple[str, ...]  # their names
    outputs: tuple[str, ...]  # names of the sensors
    responses: Mapping[str, FrequencyResponse]  # for each input the response (lines, outputs, 1) at its lines
    distortions: Mapping[str, Distortion]  # for each output what an odd multisine shows; empty for other excitation


def response(
    *sources: Source,
    inputs: Sequence[str] = (),
    sensors: Sequence[str] = (),
    period: float | None = None,
    discard: int = 1,
) -> Measurement[Response]:
    """Measure the frequency response from the periods of a multisine, with its confidence.

    Args:
        sources: one or more records of the same period: realisations of the phases, or experiments that differ in the
            signs of several inputs.
        inputs: that are excited; all that move by default.
        sensors: that are looked at; all by default.
        period: of the excitation, s; by default the one that the record states or repeats with.
        discard: periods at the start that are left out.

    Raises:
        RecordError: a column is not there, records differ, commands do not repeat with the period, there are too few
            periods, or the inputs cannot be distinguished; see `frequency_response`.
        ModelError: a setting makes no sense.
    """
    if not sources:
        raise RecordError("give at least one record of a periodic excitation")
    driving = sources[0].several("input", inputs)
    reading = tuple(sources[0].measured(c) for c in sources[0].several("sensor", sensors))
    rate = _rate(sources)
    tables = [_table(source, [c.name for c in driving], [c.name for c in reading]) for source in sources]
    period = _period(sources[0], tables[0][0], rate, discard) if period is None else period
    length = round(period * rate)
    if length >= 4 and abs(length - period * rate) <= 1e-6 * length:  # else the procedure says what is wrong
        for source, (u, _) in zip(sources, tables, strict=True):
            _refuse_other_period(source.name, u, length, rate, discard)
    shortest = min(len(u) for u, _ in tables)
    kept = shortest - shortest % max(length, 1)
    left_out = f"the last {(shortest - kept) / rate:.4g} s, no whole period, are left out"
    notes = [left_out] if kept < shortest else []
    u, y = (np.array([table[i][:kept] for table in tables]) for i in (0, 1))
    whole = responses.spectra(u, y, period=period, rate=rate, discard=discard)
    found = _responses([c.name for c in driving], whole)
    distortions: dict[str, Distortion] = {}
    if len(driving) == 1:
        for i, channel in enumerate(reading):
            alone = replace(whole, outputs=whole.outputs[..., [i]])
            try:
                distortions[channel.name] = responses.nonlinear_distortion(alone)
            except RecordError as error:
                notes.append(f"distortion is not determined: {error}")
                break
    else:
        notes.append("distortion is not determined: it takes an excitation of one input")
    made = Response(tuple(c.name for c in driving), tuple(c.name for c in reading), found, distortions)
    channels = {f"input {c.name}": c for c in driving} | {f"output {c.name}": c for c in reading}
    if next(iter(found.values())).realisations == 1:
        notes.append(
            "one realisation of the phases: the intervals hold noise only; give records with other phases, and they "
            "hold the distortion too"
        )
    rows = tuple(_rows(made, driving, reading))
    records, series = tuple(s.name for s in sources), _series(made)
    return Measurement("response", records, channels, made, _sentence(made), rows, series, tuple(notes))


def _responses(names: Sequence[str], found: Spectra) -> dict[str, FrequencyResponse]:
    """Response to each input (lines, outputs, 1)."""
    if len(names) > 1 and not (found.moved().sum(axis=1) > 1).any():
        return dict(zip(names, responses.zippered_response(found), strict=True))
    whole = responses.frequency_response(found)
    return {
        name: replace(
            whole, response=whole.response[:, :, [i]], noise=whole.noise[:, :, [i]],
            total=None if whole.total is None else whole.total[:, :, [i]],
        )
        for i, name in enumerate(names)
    }  # fmt: skip


def _rate(sources: Sequence[Source]) -> float:
    rates = [source.rate() for source in sources]
    for source, rate in zip(sources, rates, strict=True):
        if abs(rate - rates[0]) > 1e-6 * rates[0]:
            raise RecordError(
                f"{sources[0].name} has {rates[0]:.9g} samples per second, {source.name} {rate:.9g}; give records of "
                "one rate"
            )
    digits = float(f"{rates[0]:.9g}")  # a clock in floats is off a round rate by rounding
    return digits if abs(digits - rates[0]) < 1e-8 * rates[0] else rates[0]


def _table(source: Source, inputs: Sequence[str], sensors: Sequence[str]) -> tuple[Array, Array]:
    u = [source.one("input", name).values for name in inputs]
    y = [source.measured(source.one("sensor", name)).values for name in sensors]
    return np.column_stack(u), np.column_stack(y)


def _period(source: Source, u: Array, rate: float, discard: int) -> float:
    """Period that a record states, or with which its commands repeat, s."""
    meta = source.recording.manifest.get("meta")
    stated = meta.get("period") if isinstance(meta, dict) else None
    if isinstance(stated, int | float) and stated > 0.0:
        return float(stated)
    found = repeats(u, REPEATED)
    if found is None:
        raise RecordError(
            f"{source.name}: there is no period in the record: over its {len(u) / rate:.4g} s the commands do not "
            f"repeat; give --period, and a record of at least {discard + 2} periods"
        )
    return found / rate


def _refuse_other_period(name: str, u: Array, length: int, rate: float, discard: int) -> None:
    if len(u) < (discard + 2) * length:
        return  # the procedure says that there are too few
    later = u[discard * length :]
    change = later[length:] - later[:-length]
    size = np.maximum(later.std(axis=0), 1e-300)
    worst = float((np.sqrt(np.mean(change**2, axis=0)) / size).max())
    if worst > REPEATED:
        found = repeats(u, REPEATED)
        repetition = f"they repeat every {found / rate:.9g} s" if found else "they do not repeat at all"
        raise RecordError(
            f"{name}: there is no period of {length / rate:.9g} s in the record: from one such period to the next "
            f"the commands change by {100 * worst:.0f} % of their size; {repetition}: correct --period, or record a "
            "periodic excitation"
        )


def _sentence(made: Response) -> str:
    (name, found), *more = made.responses.items()
    best = int(np.argmax(np.abs(found.response[:, :, 0]).max(axis=0)))
    size = np.abs(found.response[:, best, 0])
    peak = int(np.argmax(size))
    sure = float(np.median(found.radius(LEVEL)[:, best, 0] / np.maximum(size, 1e-300)))
    ends = f"{found.frequencies[0]:.3g} to {found.frequencies[-1]:.3g} Hz"
    text = (
        f"{made.outputs[best]} answers {name} most at {found.frequencies[peak]:.3g} Hz; over {len(size)} lines from "
        f"{ends} its response is known to {percent(sure)} (95 %, median)"
    )
    if made.distortions:
        shares = made.distortions[made.outputs[best]].shares
        text += f", with {percent(shares['even'])} even and {percent(shares['odd'])} odd distortion"
    return text if not more else f"{text}; {len(more)} more input{'s' * (len(more) > 1)}"


def _rows(made: Response, driving: Sequence[Channel], reading: Sequence[Channel]) -> list[Row]:
    rows = []
    for c in driving:
        found = made.responses[c.name]
        sure = found.radius(LEVEL)[:, :, 0]
        for i, s in enumerate(reading):
            size = np.abs(found.response[:, i, 0])
            peak, pair = int(np.argmax(size)), f"{s.name}_{c.name}"
            unit = f"{s.unit or '1'}/{c.unit or '1'}" if (s.unit, c.unit) != ("", "") else ""
            deviation = float(np.sqrt(found.variance[peak, i, 0] / 2.0))
            rows += [
                Row(f"peak_{pair}", f"largest response of {s.name} to {c.name}", float(size[peak]), deviation, unit),
                Row(f"at_{pair}", "at the frequency", float(found.frequencies[peak]), None, "Hz"),
                Row(f"sure_{pair}", "half width of the 95 % interval over the response, median over lines",
                    float(np.median(sure[:, i] / np.maximum(size, 1e-300)))),
            ]  # fmt: skip
    for name, distortion in made.distortions.items():
        rows += [
            Row(f"{kind}_{name}", f"{kind} {'distortion' * (kind != 'noise')} of {name}, part of it".replace("  ", " "),
                share)
            for kind, share in distortion.shares.items()
        ]  # fmt: skip
    first = next(iter(made.responses.values()))
    rows += [
        Row("periods", "periods of each record that are used", float(first.periods)),
        Row("realisations", "realisations of the phases", float(first.realisations)),
    ]
    return rows


def _series(made: Response) -> dict[str, Array]:
    """Responses as columns: real and imaginary part, radius of the 95 % circle; and the distortions."""
    found: dict[str, Array] = {}
    for name, each in made.responses.items():
        found[f"frequency_{name}"] = each.frequencies
        radius = each.radius(LEVEL)
        for i, output in enumerate(made.outputs):
            pair = f"{output}_{name}"
            found[f"real_{pair}"], found[f"imaginary_{pair}"] = each.response[:, i, 0].real, each.response[:, i, 0].imag
            found[f"radius_{pair}"] = radius[:, i, 0]
    for output, distortion in made.distortions.items():
        found[f"line_{output}"] = distortion.frequencies
        found[f"level_{output}"], found[f"noise_{output}"] = distortion.level, distortion.noise
    return found
