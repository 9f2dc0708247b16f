"""Physical effects in sensors (of the true value `s`), in actuators (of the command `u`) and in the loop."""

from __future__ import annotations

from functools import partial

from masking.model.effects import starts
from masking.model.effects.entry import NOT_NEGATIVE, POSITIVE, SATURATION, Effect, EffectParameter, EffectState, Trial

_sensor = partial(Effect, where="sensor", family="sensor errors")
_actuator = partial(Effect, where="actuator")
_gain, _dynamics = partial(_actuator, family="actuator gains"), partial(_actuator, family="actuator dynamics")
_DOEBELIN = "Doebelin (2003), Measurement Systems, section 3.2"
_TAO = "Tao and Kokotovic (1996), Adaptive Control of Systems with Actuator and Sensor Nonlinearities, ch. 1"
_PADE = "Franklin, Powell and Emami-Naeini (2015), Feedback Control of Dynamic Systems, section 5.6.3"
_WIDROW = "Widrow and Kollar (2008), Quantization Noise, ch. 1"
_SAMPLED = "raise the resolution of the converter or amplify the signal to fill its range"

# Values from which fits start.
_CLIPPED = (0.8, 0.9, 0.97, 1.0)  # what is clipped reads the limit, and its noise
_LIMITS = (0.3, 0.45, 0.6, 0.75, 0.9)  # beyond 1 nothing is cut off
_ZONES = (0.01, 0.03, 0.08, 0.2)  # half-decades
_LAGS = (0.02, 0.1, 0.4)  # of the time of the motion: a filter or amplifier, a coil under voltage, and a slow drive
_SPREAD = 0.03  # of the range: twice to three times the error of a sensor that is sold for it
_ANY = "1e3"  # a record may begin in motion
_LOST = EffectParameter("1", "part of the reading that has lost its sign", (0.0, 1.0), 1.0, None, (0.0, 1.0), (1.0,))
_SILENT = EffectParameter("U", "largest value without an answer", (0.0, 1.0), 0.01, None, NOT_NEGATIVE, _ZONES)
_HEAT = "(where(P < limit, r*u**2, min(r*u**2, limit)) - P)/tau"

INSTRUMENTS: tuple[Effect, ...] = (
    _sensor(
        "sensor_offset",
        "Every reading is shifted by the same amount.",
        "s + e0",
        {"e0": EffectParameter("S", "offset", (-0.5, 0.5), 0.01)},
        cause="a zero that was not adjusted",
        remedy="adjust the zero at rest before each run",
        source=_DOEBELIN,
    ),
    _sensor(
        "sensor_drift",
        "The zero of the sensor moves steadily from where it was at first.",
        "s + e",
        {"rate": EffectParameter("S/s", "change of the zero in a second", (-0.1, 0.1), 1e-3)},
        cause="an amplifier or sensor that warms up, a charge that leaks",
        remedy="let the rig warm up before it is used, adjust the zero between runs",
        source=_DOEBELIN,
        states={"e": EffectState("rate", "S", "shift of the zero", _ANY)},
        nested=("sensor_offset",),
    ),
    _sensor(
        "sensor_gain",
        "The sensor's gain differs from the declared one.",
        "s*(1 + e)",
        {"e": EffectParameter("1", "relative error of the gain", (-0.3, 0.3), 0.02)},
        cause="a calibration at another distance, temperature or supply voltage",
        remedy="calibrate against a gauge over the whole stroke",
        source=_DOEBELIN,
        is_linear=True,
    ),
    _sensor(
        "sensor_saturation",
        "The reading is clipped at a limit.",
        "min(max(s, -limit), limit)",
        {"limit": EffectParameter("S", "largest magnitude", (0.1, 20.0), 10.0, None, NOT_NEGATIVE, _CLIPPED)},
        cause="the end of the range of a sensor, amplifier or converter",
        remedy="lower the gain or stay within the range; beyond it the state cannot be known",
        source=_TAO,
    ),
    _sensor(
        "sensor_lag",
        "The reading follows through a first-order lag.",
        "m",
        {"tau": EffectParameter("s", "time constant", (1e-5, 0.1), 1e-3, None, POSITIVE, _LAGS[:2])},
        cause="a filter in the amplifier, a slow sensor",
        remedy="raise the cut-off of the filter",
        source="Doebelin (2003), Measurement Systems, section 3.3",
        states={"m": EffectState("(s - m)/tau", "S", "filtered value", _ANY)},
        is_linear=True,
        grows_with="tau",
    ),
    _sensor(
        "sensor_cubic",
        "The sensor's gain changes towards the ends of its range.",
        "s + c*s**3",
        {"c": EffectParameter("S**(-2)", "cubic coefficient", (-1.0, 1.0), 0.01, spread=_SPREAD)},
        cause="a sensor used beyond its linear range, the field of a coil towards its end",
        remedy="calibrate over the whole stroke and undo the curve, or stay near the middle",
        source=_DOEBELIN,
    ),
    _sensor(
        "sensor_rectification",
        "The sensor's gain differs between the two signs.",
        "s + r*abs(s)",
        {
            "r": EffectParameter(
                "1", "half the difference of the gains", (-1.0, 1.0), 0.02, None, (-1.0, 1.0), (), _SPREAD
            )
        },
        cause="a diode or a demodulator that is out of balance",
        remedy="adjust the demodulator, or undo the difference",
        source=_DOEBELIN,
    ),
    _sensor(
        "sensor_magnitude",
        "The sensor counts without the sign: at r = 1 the reading is the magnitude.",
        "(1 - r)*s + r*abs(s)",
        {"r": _LOST},
        cause="a pulse counter, an encoder with one track, a rectifier",
        remedy="use a sensor of direction, too, such as a second track",
        source="Wigren and Schoukens (2013), European Control Conference, 2933-2938",
        positive="r - 3/4",
    ),
    _sensor(
        "sensor_delay",
        "The reading comes late by a dead time, in the first-order approximation of Pade.",
        "2*m - s",
        {"tau": EffectParameter("s", "dead time", (1e-4, 0.1), 2e-3, None, POSITIVE, (0.04, 0.2))},
        cause="a sensor that computes, a bus or a network, averaging in a converter",
        remedy="read it earlier",
        source=_PADE,
        states={"m": EffectState("2*(s - m)/tau", "S", "mean of the reading and the value", _ANY)},
        is_linear=True,
        grows_with="tau",
    ),
    _sensor(
        "quantisation",
        "The reading is rounded to multiples of a step; a step of 0 leaves it unchanged.",
        "where(step > 0, step*floor(s/step + 1/2), s)",
        {"step": EffectParameter("S", "step", (0.0, 0.1), 3e-4, None, NOT_NEGATIVE)},
        cause="a converter of finite resolution, an encoder",
        remedy=_SAMPLED,
        source=_WIDROW,
        family="quantisation",
        is_searched=False,
        quantum="step",
        deviation="step/sqrt(12)",
    ),
    _sensor(
        "noise",
        "White noise on the readings, independent from sample to sample.",
        "s + sigma*xi",
        {"sigma": EffectParameter("S", "standard deviation of a sample", (0.0, 0.1), 1e-3, None, NOT_NEGATIVE)},
        cause="thermal noise of the electronics, stray fields, vibration of the sensor's mount",
        remedy="shield and shorten cables, filter before sampling",
        source="Astrom (1970), Introduction to Stochastic Control Theory, ch. 2",
        family="noise",
        is_searched=False,
        deviation="sigma",
    ),
    _gain(
        "actuator_offset",
        "The actuator acts at a command of zero.",
        "u + u0",
        {"u0": EffectParameter("U", "offset", (-0.5, 0.5), 0.01)},
        cause="an amplifier or converter whose zero was not adjusted",
        remedy="adjust the zero, or add its negative to the input",
        source="Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, ch. 10",
    ),
    _gain(
        "actuator_gain",
        "The actuator's gain differs from the declared one.",
        "(1 + e)*u",
        {"e": EffectParameter("1", "relative error of the gain", (-0.5, 0.5), 0.05)},
        cause="a wrong motor constant, a weaker magnet, a coil outside its homogeneous field",
        remedy="identify the gain anew with the rig as it is",
        source="Rijlaarsdam (2008), Table 4.2, c_i",
        absorbed_by="gain",
        is_linear=True,
    ),
    _gain(
        "actuator_asymmetry",
        "The actuator's gain differs between the two signs.",
        "u + r*abs(u)",
        {
            "r": EffectParameter(
                "1", "half the difference of the gains", (-1.0, 1.0), 0.05, None, (-1.0, 1.0), (), _SPREAD
            )
        },
        cause="the two halves of an amplifier or bridge, a motor with worn brushes, one side of a valve",
        remedy="undo the difference in the command, or repair the weaker half",
        source=_TAO,
    ),
    _actuator(
        "saturation",
        "The command is clipped at a limit.",
        "min(max(u, -limit), limit)",
        {"limit": EffectParameter("U", "largest magnitude", (0.01, 50.0), 0.42, None, NOT_NEGATIVE, _LIMITS)},
        cause="the supply of the amplifier, a fuse, a limit in software",
        remedy="ask for less: smaller amplitude, slower time scale, a virtual system nearer to the rig",
        source=_TAO,
        family=SATURATION,
    ),
    _dynamics(
        "dead_zone",
        "The actuator does nothing for small values.",
        "u - min(max(u, -width), width)",
        {"width": _SILENT},
        cause="the crossover of an amplifier, a valve that overlaps",
        remedy="a bias current, or add the width in the direction of the command",
        source=_TAO,
    ),
    _gain(
        "actuator_cubic",
        "The actuator's gain changes towards the ends of its range.",
        "u + c*u**3",
        {"c": EffectParameter("U**(-2)", "cubic coefficient", (-10.0, 10.0), 0.1, spread=_SPREAD)},
        cause="a voice coil that leaves its field, an amplifier near its supply",
        remedy="ask for less, or undo the curve",
        source="Preumont (2011), Vibration Control of Active Structures, section 3.2",
    ),
    _dynamics(
        "dac_quantisation",
        "The command is rounded to multiples of a step; a step of 0 leaves it unchanged.",
        "where(step > 0, step*floor(u/step + 1/2), u)",
        {"step": EffectParameter("U", "step", (0.0, 0.1), 3e-4, None, NOT_NEGATIVE)},
        cause="a converter of finite resolution",
        remedy=_SAMPLED,
        source=_WIDROW,
        label="DAC quantisation",
        trials=(Trial(starts.levels, ("step",)),),
        quantum="step",
    ),
    _dynamics(
        "actuator_lag",
        "The actuator follows through a first-order lag.",
        "a",
        {"tau": EffectParameter("s", "time constant", (1e-5, 0.1), 1e-3, None, POSITIVE, _LAGS)},
        cause="the inductance of the coil under voltage, the bandwidth of the amplifier",
        remedy="a faster amplifier, such as one that controls the current of a coil",
        source="Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, ch. 2",
        states={"a": EffectState("(u - a)/tau", "U", "value that acts", _ANY)},
        is_linear=True,
        grows_with="tau",
    ),
    _dynamics(
        "actuator_delay",
        "The actuator acts late by a dead time.",
        "",
        {"tau": EffectParameter("s", "dead time", (1e-4, 0.1), 2e-3, None, NOT_NEGATIVE)},
        cause="the driver of one actuator has a buffer, a bus or a network of its own",
        remedy="lead the command by the dead time, or use drivers of one kind",
        source="Astrom and Wittenmark (1997), Computer-Controlled Systems, section 3.2",
        is_searched=False,
        is_linear=True,
        grows_with="tau",
    ),
    _actuator(
        "thermal",
        "The coil warms up, and its driver limits the mean power.",
        "where(P < limit, u, min(max(u, -sqrt(limit/r)), sqrt(limit/r)))",
        {
            "r": EffectParameter("W/U**2", "power per squared value", (1e-3, 1e3), 10.0, None, NOT_NEGATIVE),
            "tau": EffectParameter("s", "thermal time constant", (1.0, 1e3), 10.0, 10.0, POSITIVE),
            "limit": EffectParameter("W", "largest mean power", (0.1, 100.0), 8.0, 8.0, NOT_NEGATIVE),
        },
        cause="the resistance of the coil turns current into heat faster than it is carried away",
        remedy="run for shorter or at smaller amplitude, cool the actuator",
        source="Incropera and DeWitt (2002), Fundamentals of Heat and Mass Transfer, section 5.1",
        states={"P": EffectState(_HEAT, "W", "mean power of the coil")},
        family=SATURATION,
        is_searched=False,
    ),
    Effect(
        "delay",
        "Commands act some samples late.",
        "",
        {"samples": EffectParameter("1", "whole samples", (0.0, 20.0), 1.0, None, NOT_NEGATIVE, (1.0,))},
        cause="the time of computing, buffers of converters and drivers, a network",
        remedy="shorten the time between a reading and the command that answers it",
        source="Astrom and Wittenmark (1997), Computer-Controlled Systems, section 3.5",
        where="loop",
        family="delay",
        is_searched=False,
        is_linear=True,
        grows_with="samples",
    ),
)
