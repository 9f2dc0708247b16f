"""Texts as loggers write them: each is read with the numbers that it was made of, or refused with what mends it."""

import datetime
import io
from dataclasses import dataclass, field

import numpy as np
import pytest

from masking.errors import RecordError
from masking.lab.records import readers, text_header
from masking.lab.records.record_form import TextForm

N = 200
T = np.arange(N) * 0.002
F = np.round(np.sin(40.0 * T) + 0.25, 6)
Q = np.round(0.01 * np.cos(25.0 * T), 9)
SIZES = {"": 1.0, "N": 1.0, "m": 1.0, "kN": 1e3, "mm": 1e-3, "um": 1e-6, "mN": 1e-3, "s": 1.0}
FIRST = datetime.datetime(2024, 5, 3, 23, 59, 59, 900_000, tzinfo=datetime.UTC)  # midnight comes within the record
MAP = {"t": "TIME", "F": "CH1", "q": "CH2"}


def rows(separator=",", comma=False, columns=(T, F, Q), end="", form="{:.9g}"):
    """Rows of numbers."""
    texts = [[form.format(v) if isinstance(v, float) else str(v) for v in row] for row in zip(*columns, strict=True)]
    texts = [[cell.replace(".", ",") for cell in row] for row in texts] if comma else texts
    return "\n".join(separator.join(row) + end for row in texts) + "\n"


def saved(**settings):
    """What numpy.savetxt writes."""
    stream = io.StringIO()
    np.savetxt(stream, np.column_stack([T, F, Q]), **settings)
    return stream.getvalue()


def stamped(form, cut=None):
    """Instants of the record on a wall clock."""
    made = [(FIRST + datetime.timedelta(seconds=float(t))).strftime(form) for t in T]
    return [one[:cut] for one in made]


@dataclass(frozen=True)
class Written:
    """A text, how it is read, and the words that it is refused with; none where it is read."""

    name: str
    text: str | bytes
    names: object = field(default_factory=dict)
    form: TextForm = TextForm()  # noqa: RUF009
    refused: tuple[str, ...] = ()
    ending: str = "csv"
    dt: float | None = None


LVM = "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nMulti_Headings\tNo\n"
LVM_CHANNELS = (
    "Time_Pref\tRelative\nDate\t2024/05/03\nTime\t10:00:00\n***End_of_Header***\t\n\t\nChannels\t2\t\nSamples\t200\t200\n"
    "Y_Unit_Label\tNewton\tmm\nX_Dimension\tTime\tTime\nX0\t0,0E+0\t0,0E+0\nDelta_X\t0,002000\t0,002000\n"
    "***End_of_Header***\t\t\n"
)
TEKTRONIX = (
    "Model,MSO24\nFirmware Version,1.44\n\nWaveform Type,ANALOG\nHorizontal Units,s\n"
    "Sample Interval,0.002\nRecord Length,200\nVertical Units,V,V\nVertical Scale,1.0,2.0\n\n"
)
SIDE = ["Record Length,200,", "Sample Interval,0.002,", "Trigger Point,100,", *[",,"] * (N - 3)]
PLAIN = ("t", "F", "q")
SI = {"t": "Time", "F": "Force", "q": "Way"}

HEADERS = [
    Written("names alone", "t,F,q\n" + rows()),
    Written("Tektronix", TEKTRONIX + "TIME,CH1,CH2\n" + rows(), MAP),
    Written("Tektronix, names given", TEKTRONIX + "TIME,CH1,CH2\n" + rows(), PLAIN, TextForm(11)),
    Written("Tektronix, names given beside names", TEKTRONIX + "TIME,CH1,CH2\n" + rows(), PLAIN,
            refused=("line 11 names its columns", "--map t=TIME", "--header-rows 11")),
    Written("Tektronix, preamble beside the numbers", "".join(
        f"{side}{row}\n" for side, row in zip(SIDE, rows().splitlines(), strict=True)), ("a", "b", *PLAIN)),
    Written("Tektronix, preamble beside the numbers, no names", "".join(
        f"{side}{row}\n" for side, row in zip(SIDE, rows().splitlines(), strict=True)), refused=("--columns t,u1,y1",)),
    Written("Keysight", "x-axis,1,2\nsecond,Newton,Meter\n" + rows(), {"t": "x-axis", "F": "1", "q": "2"}),
    Written("Keysight, names with units",
            "Time (s),Channel 1 (mN),Channel 2 (um)\n" + rows(columns=(T, F * 1e3, Q * 1e6)),
            {"t": "Time", "F": "Channel 1", "q": "Channel 2"}),
    Written("Rigol, start and increment", "X,CH1,CH2,Start,Increment,\nSequence,N,m,0.0,0.002,\n" + rows(
        columns=(np.arange(N), F, Q), end=",,,"), {"t": "X", "F": "CH1", "q": "CH2"}),
    Written("Rigol, times", "Time(ms),CH1(N),CH2(m)\n" + rows(columns=(T * 1e3, F, Q)),
            {"t": "Time(ms)", "F": "CH1(N)", "q": "CH2(m)"}),
    Written("LeCroy",
            "LECROYWaveSurfer,12345,Waveform\nSegments,1,SegmentSize,200\nSegment,TrigTime,TimeSinceSegment1\n"
            "#1,03-May-2024 10:00:00,0\nTime,Force,Way\n" + rows(), SI),
    Written("Siglent", "Record Length,Analog:200\nSample Interval,0.002\nVertical Units,V\nSource,CH1,CH2\n"
            "Second,Force,Way\n" + rows(), {"t": "Second:s", "F": "Force", "q": "Way"}),
    Written("PicoScope", "Time,Force,Way\n(ms),(N),(mm)\n\n" + rows(columns=(T * 1e3, F, Q * 1e3)), SI),
    Written("PicoScope, microseconds", "Time,Force,Way\n(μs),(kN),(m)\n\n" + rows(
        columns=(T * 1e6, F * 1e-3, Q)), SI),
    Written("units without brackets", "t,F,q\ns,N,mm\n" + rows(columns=(T, F, Q * 1e3))),
    Written("units in square brackets", "t;F;q\n[ms];[N];[m]\n" + rows(";", columns=(T * 1e3, F, Q))),
    Written("testing machine, all quoted", '"Time","Force","Way"\n"(s)","(N)","(mm)"\n' + "".join(
        f'"{t:.9g}","{f:.9g}","{q:.9g}"\n' for t, f, q in zip(T, F, Q * 1e3, strict=True)), SI),
    Written("title, operator, names, units", "Rig 3\nOperator:\tMeyer\n\nTime\tForce\tWay\ns\tN\tmm\n" + rows(
        "\t", columns=(T, F, Q * 1e3)), SI),
    Written("channels, then names", "Channel 1,Channel 2,Channel 3\nt,F,q\n" + rows()),
    Written("sep=;", "sep=;\nt;F;q\n" + rows(";", comma=True)),
    Written("names that are numbers", "t,1,2\n" + rows(), {"F": "1", "q": "2"}),
    Written("units without names", "(s),(N),(m)\n" + rows(), refused=("no column t", "--map t=")),
    Written("no names", rows(), refused=("--columns t,u1,y1",)),
    Written("no names, named", rows("\t"), PLAIN),
    Written("no names below a preamble", "Model,MSO24\nLength,200\n" + rows(),
            refused=("3 cells, but 2 columns", "--header-rows 2", "--columns")),
    Written("no names below a preamble, named", "Model,MSO24\nLength,200\n" + rows(), PLAIN, TextForm(2)),
    Written("two units of one name", "x [mm],x [deg],t\n0,1,2\n1,2,3\n", {"F": "x", "q": "x [deg]"},
            refused=("no column x",)),
]  # fmt: skip
REMARKS = [
    Written("savetxt, commas", saved(delimiter=",", header="t,F,q")),
    Written("savetxt, blanks", saved(header="t F q"), ending="txt"),
    Written("savetxt, two lines", saved(header="made on Monday\nt F q"), ending="txt"),
    Written("savetxt, commas above blanks", saved(header="t, F, q"), ending="dat"),
    Written("gnuplot, units", "# Time (s)  Force (N)  Way (m)\n" + rows(" "), SI, ending="dat"),
    Written("gnuplot, row of units", "# t F q\n# s N mm\n" + rows("  ", columns=(T, F, Q * 1e3)), ending="dat"),
    Written("names behind a percent sign", "% t F q\n" + rows(" "), ending="txt"),
    Written("ROS, map with the mark", "%time,field.F,field.q\n" + rows(
        columns=(1423155837204827070 + np.rint(T * 1e9).astype(np.int64), F, Q)),
        {"t": "%time:ns", "F": "field.F", "q": "field.q"}),
    Written("ROS, no unit", "%time,field.F,field.q\n" + rows(
        columns=(1423155837204827070 + np.rint(T * 1e9).astype(np.int64), F, Q)),
        {"t": "%time", "F": "field.F", "q": "field.q"}, refused=("--map t=time:ns, or --map t=time:s",)),
    Written("remark between names and numbers", "t,F,q\n# of today\n% and of me\n" + rows()),
]  # fmt: skip
CELLS = [
    Written("quotes behind blanks", '"t", "F", "q"\n' + rows(", ")),
    Written("aligned", "   t       F      q\n" + "".join(f"{t:10.4f} {f:14.7e}  {q:14.9e}\n" for t, f, q in
            zip(T, F, Q, strict=True)), ending="txt"),
    Written("tabs and decimal commas", "t\tF\tq\n" + rows("\t", comma=True), ending="txt"),
    Written("blanks and decimal commas", "t F q\n" + rows("  ", comma=True), ending="txt"),
    Written("German, with an order mark", "\ufeffZeit [s];Kraft [N];Weg [m];\n" + rows(";", comma=True, end=";"),
            {"t": "Zeit", "F": "Kraft", "q": "Weg"}),
    Written("German, names with units in the map", "Zeit [ms];Kraft [N];Weg [mm]\n" + rows(
        ";", comma=True, columns=(T * 1e3, F, Q * 1e3)), {"t": "Zeit [ms]", "F": "Kraft [N]", "q": "Weg [mm]"}),
    Written("commas that may be thousands", "t\tF\tq\n" + "".join(f"{i}\t1,{i:03}\t2,{i:03}\n" for i in range(N)),
            refused=("line 2 holds '1,000': its comma may be a decimal one or stand for thousands",)),
    Written("decimal commas between commas", "t,F,q\n" + rows(comma=True), refused=("are there decimal commas",)),
    Written("points and commas", "t\tF\tq\n0,002\t1.5\t1\n" + rows("\t"), refused=("line 2 holds '1.5'",)),
    Written("overflow of a scope", "Time,Force,Way\n(s),(N),(m)\n\n0,1,∞\n" + rows(columns=(T + 1, F, Q)), SI,
            refused=("line 4", "∞")),
    Written("a broken first row", "t,F,q\n0,OVL,1\n" + rows(columns=(T + 1, F, Q)), refused=("line 2 holds 'OVL'",)),
    Written("text beside numbers", "t,note,F,q\n" + "".join(
        f"{t:.9g},{'up' if q > 0 else 'down'},{f:.9g},{q:.9g}\n" for t, f, q in zip(T, F, Q, strict=True))),
]  # fmt: skip
CLOCKS = [
    Written("ISO", "t,F,q\n" + rows(columns=(stamped("%Y-%m-%d %H:%M:%S.%f"), F, Q))),
    Written("ISO with T and Z", "t,F,q\n" + rows(columns=(stamped("%Y-%m-%dT%H:%M:%S.%fZ"), F, Q))),
    Written("ISO, milliseconds", "t,F,q\n" + rows(columns=(stamped("%Y-%m-%d %H:%M:%S.%f", -3), F, Q))),
    Written("time of the day across midnight", "t,F,q\n" + rows(columns=(stamped("%H:%M:%S.%f"), F, Q))),
    Written("twelve hours", "t,F,q\n" + rows(columns=(stamped("%m/%d/%Y %I:%M:%S.%f %p"), F, Q)),
            refused=("not a number", "write instants as", "--dt")),
    Written("days with dots, decimal commas", "Zeit;F;q\n" + rows(
        ";", comma=True, columns=([s.replace(":", ":") for s in stamped("%d.%m.%Y %H:%M:%S")], F, Q)).replace(
        "03,05,", "03.05.").replace("04,05,", "04.05."), {"t": "Zeit"}, refused=("must increase strictly", "--dt"),),
    Written("day and month unknown, one date", "t,F,q\n" + rows(
        columns=([s.replace("23:59:59", "12:00:00") for s in stamped("05/03/2024 %H:%M:%S.%f")[:N // 4]], F[:N // 4],
                 Q[:N // 4]))),
    Written("a name in ms", "time_ms,F,q\n" + rows(columns=(T * 1e3, F, Q)), {"t": "time_ms"},
            refused=("--map t=time_ms:ms, or --map t=time_ms:s",)),
    Written("a name in ms, said", "time_ms,F,q\n" + rows(columns=(T * 1e3, F, Q)), {"t": "time_ms:ms"}),
    Written("micros", "t [us],F,q\n" + rows(columns=(np.rint(T * 1e6).astype(int), F, Q))),
    Written("an unknown unit", "t [furlong],F,q\n" + rows(), refused=("in 'furlong'", "--map t=t [furlong]:ms")),
]  # fmt: skip
ENCODED = [
    Written("GBK", ("时间,力,位移\n(s),(N),(mm)\n" + rows(columns=(T, F, Q * 1e3))).encode("gbk"),
            {"t": "时间", "F": "力", "q": "位移"}, TextForm(encoding="gbk")),
    Written("GBK, not said", ("时间,力,位移\n" + rows()).encode("gbk"), refused=("line 1", "--encoding latin-1, gbk")),
    Written("latin-1", ("Zeit (s);Kraft (N);Weg (µm)\n" + rows(";", columns=(T, F, Q * 1e6))).encode("latin-1"),
            {"t": "Zeit", "F": "Kraft", "q": "Weg"}, TextForm(encoding="latin-1")),
    Written("UTF-16", ("t\tF\tq\n" + rows("\t")).encode("utf-16"), form=TextForm(encoding="utf-16"), ending="txt"),
    Written("UTF-16, not said", ("t\tF\tq\n" + rows("\t")).encode("utf-16"), refused=("--encoding utf-16",)),
    Written("no encoding", "t,F,q\n" + rows(), form=TextForm(encoding="rot13"),
            refused=("no encoding 'rot13'", "latin-1")),
]  # fmt: skip
LABVIEW = [
    Written("LabVIEW, no X values", LVM + "X_Columns\tNo\n" + LVM_CHANNELS + "X_Value\tF\tq\tComment\n" + "".join(
        f"\t{f:.9g}\t{q:.9g}\n".replace(".", ",") for f, q in zip(F, Q * 1e3, strict=True)), ending="lvm"),
    Written("LabVIEW, X values", LVM + "X_Columns\tOne\n" + LVM_CHANNELS + "X_Value\tF\tq\tComment\n" + rows(
        "\t", columns=(T, F, Q * 1e3)).replace("\n", "\tstart\n", 1), ending="lvm"),
    Written("LabVIEW, two clocks",
            LVM + "X_Columns\tMulti\n" + LVM_CHANNELS + "X_Value\tF\tX_Value\tq\tComment\n" + rows(
        "\t", columns=(T, F, T, Q)), ending="lvm", refused=("a clock for each channel", "--header-rows")),
    Written("LabVIEW, two increments", LVM + "X_Columns\tNo\n" + LVM_CHANNELS.replace("\t0,002000\n", "\t0,001000\n") +
            "X_Value\tF\tq\tComment\n\t1\t2\n", ending="lvm", refused=("several values of Delta_X",)),
    Written("LabVIEW, cut off", LVM, ending="lvm", refused=("cut off",)),
]  # fmt: skip
ALL = [*HEADERS, *REMARKS, *CELLS, *CLOCKS, *ENCODED, *LABVIEW]


def test_there_are_sixty_texts_with_names_of_their_own():
    assert len({one.name for one in ALL}) == len(ALL) >= 60


@pytest.mark.parametrize("one", ALL, ids=[one.name for one in ALL])
def test_a_text_of_a_logger_is_read_right_or_refused_with_what_mends_it(one, tmp_path, monkeypatch):
    """Work is bounded: a line of the header is split a few times, and each of the body once."""
    split, plain = [], text_header.cells
    monkeypatch.setattr(text_header, "cells", lambda line, separator: split.append(0) or plain(line, separator))
    path = tmp_path / f"a.{one.ending}"
    path.write_bytes(one.text if isinstance(one.text, bytes) else one.text.encode())
    if one.refused:
        with pytest.raises(RecordError) as refused:
            readers.read(path, one.names, one.dt, ("F", "q"), one.form)
        assert not [words for words in one.refused if words not in str(refused.value)], str(refused.value)
    else:
        found = readers.read(path, one.names, one.dt, ("F", "q"), one.form)
        count = len(found)
        np.testing.assert_allclose(found.t - found.t[0], T[:count], rtol=1e-9, atol=5e-7)
        for name, values in {"F": F, "q": Q}.items():
            size = SIZES[found.units.get(name, "")]
            np.testing.assert_allclose(found[name] * size, values[:count], rtol=1e-7, atol=1e-12)
    assert len(split) <= 4 * text_header._SAMPLE + 2 * N + 100
