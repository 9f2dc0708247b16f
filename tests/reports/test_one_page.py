"""One page of a result: a sheet of A4 whose text stays inside, in the words of the pages, from files alone."""

import json
import re
from dataclasses import replace
from itertools import combinations

import matplotlib as mpl
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.text import Text

import masking
from masking.app.cli import main
from masking.app.workflows.run import save
from masking.display.json_text import json_text
from masking.errors import RecordError
from masking.lab.records.recording import Recording
from masking.reports import one_page, one_page_drawing, run_text
from masking.reports.html import Tile
from masking.reports.one_page import Sheet
from masking.reports.run_study import Study
from tests.reports.test_run_report import Page, duffing

MARGIN = 0.08  # of the width: no letter is nearer to the edge
WORDS = "dry friction in spring1 makes 74 % of the error on unseen data, odds 300 : 1 against a constant force. "
PLAIN = Sheet(
    title="What the model is missing",
    subject=["linear rig", "record a.csv"],
    tiles=[Tile("Dry friction in spring1", "99 %", "probability"), Tile("error in s1", "0.51 %", "noise 0.51 %", True)],
    sections={one_page.FOUND: [WORDS], one_page.NEXT: [WORDS, WORDS]},
    errors={"as declared": {"s1": 0.2, "s2": 0.1}, "with the finding": {"s1": 0.01, "s2": 0.02}},
    errors_title="Simulation error, validation record",
    errors_label="error relative to the reading",
    page="discovery.html",
)
NAMES = [f"{'W' * 40}{i}" for i in range(20)]
SHEETS = {
    "plain": PLAIN,
    "bare": Sheet(title="Nothing is missing", subject=[], tiles=[], sections={}, page="discovery.html"),
    "many causes": replace(PLAIN, sections={one_page.FOUND: [WORDS] * 40, one_page.SURE: [WORDS] * 40}),
    "long words": replace(
        PLAIN,
        title="W" * 300,
        subject=["/data/" + "folder" * 200],
        tiles=[Tile("W" * 90, "1.234567e-123456789", "W" * 60)] * 9,
        sections={f"{heading} {'W' * 90}": [WORDS * 9, "W" * 900] for heading in range(12)},
        errors_label="W" * 500,
        errors_title="W" * 300,
    ),
    "many channels": replace(PLAIN, errors={model: dict.fromkeys(NAMES, 0.5) for model in NAMES}),
    "not finite": replace(PLAIN, errors={"as declared": {}, "with the finding": {"s1": 0.01}}),
    "no error": replace(PLAIN, errors={"masking error": {"x1": 0.0}}),
    "noise alone": replace(PLAIN, errors={"noise floor": {"x1": 0.1}}),
    "no markup": replace(PLAIN, title="Costs $5 and $6 of 7_8^9 \\alpha", tiles=[Tile("$x_1$", "a$", "b$")]),
}


def texts(figure):
    """Return each text that is drawn on a figure, and its corners in parts of the sheet."""
    canvas, (width, height) = FigureCanvasAgg(figure), figure.bbox.size
    canvas.draw()  # labels of axes find their places
    renderer, found = canvas.get_renderer(), []
    beyond = [
        label
        for axes in figure.axes
        for label, at in zip(axes.get_xticklabels(), axes.get_xticks(), strict=True)
        if not axes.get_xlim()[0] <= at <= axes.get_xlim()[1]  # which is not drawn
    ]
    for one in figure.findobj(lambda artist: isinstance(artist, Text) and artist.get_visible()):
        box = one.get_window_extent(renderer)
        if one.get_text().strip() and one not in beyond:
            found.append((one.get_text(), box.x0 / width, box.y0 / height, box.x1 / width, box.y1 / height))
    return found


def shown(figure):
    """Return all text of a figure, its lines joined."""
    return " ".join(text for text, *_ in texts(figure)).replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize("name", SHEETS)
def test_no_text_leaves_the_sheet_or_covers_another(name):
    with mpl.rc_context({"text.hinting": "none"}):
        figure = one_page_drawing.drawn(SHEETS[name])
        found = texts(figure)
    assert figure.get_size_inches() * 25.4 == pytest.approx((210.0, 297.0))
    for text, left, below, right, above in found:
        assert left > MARGIN, text
        assert right < 1.0 - MARGIN, text
        assert below > 0.05, text
        assert above < 0.95, text
    for (one, left, below, right, above), (other, *box) in combinations(found, 2):
        apart = right <= box[0] or box[2] <= left or above <= box[1] + 1e-3 or box[3] <= below + 1e-3
        assert apart, (one, other)


@pytest.mark.parametrize("name", ["plain", "bare", "not finite", "no error", "noise alone", "no markup"])
def test_what_fits_is_all_there(name):
    sheet, text = SHEETS[name], shown(one_page_drawing.drawn(SHEETS[name]))
    parts = [sheet.title, *sheet.subject, *sheet.sections, *(cell for tile in sheet.tiles for cell in tile[:3])]
    for part in (*parts, *(paragraph for every in sheet.sections.values() for paragraph in every)):
        assert part.strip() in text
    assert "discovery.html has more." in text
    assert ("20 % → 1 %" in text) is (name in {"plain", "no markup"})
    assert ("not finite → 1 %" in text) is (name == "not finite")


@pytest.mark.parametrize("name", ["many causes", "long words", "many channels"])
def test_what_does_not_fit_is_said_to_be_elsewhere(name):
    assert "Shortened to one page; discovery.html has all." in shown(one_page_drawing.drawn(SHEETS[name]))


@pytest.mark.parametrize("name", SHEETS)
def test_a_sheet_comes_back_from_its_file(tmp_path, name):
    (tmp_path / one_page.DISCOVERY).write_text(json_text({"sheet": SHEETS[name], "verdict": "named"}), encoding="utf-8")
    assert one_page.read(tmp_path / one_page.DISCOVERY) == SHEETS[name]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Return the folder of a run that is saved with its report."""
    folder = tmp_path_factory.mktemp("run")
    save(duffing(2000, error=0.02, limits={"u1": {"max": 0.1, "unit": "V"}}), folder)
    return folder


def test_a_run_gets_one_sheet_of_a4(run, capsys):
    assert main(["report", str(run), "--one-page", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    content = (run / "one_page.pdf").read_bytes()
    assert told == {"report": str(run / "one_page.pdf"), "figures": [str(run / "one_page.png")]}
    assert len(re.findall(rb"/Type /Page\b", content)) == 1
    (box,) = re.findall(rb"/MediaBox \[ ?0 0 ([\d.]+) ([\d.]+) ?\]", content)
    assert [float(side) / 72.0 * 25.4 for side in box] == pytest.approx([210.0, 297.0], abs=0.1)
    fonts = re.findall(rb"/Type /FontDescriptor\b", content)
    assert len(fonts) == content.count(b"/FontFile2") > 0  # each is in the file
    assert (run / "one_page.png").read_bytes().startswith(b"\x89PNG\r\n")
    masking.report(run, one_page=True)
    assert (run / "one_page.pdf").read_bytes() == content


def test_a_run_is_said_in_the_words_of_its_page(run):
    study, page = Study(Recording.load(run)), Page((run / "report.html").read_text("utf-8")).text
    sheet = masking.app.workflows.run._sheet(run)
    first = sheet.sections[one_page.FOUND][0]
    assert first == " ".join(run_text.headline(study))
    assert sheet.sections[one_page.LIMITS] == run_text.warnings(study)
    assert "0.21 V, 2.1 times its limit of 0.1 V" in sheet.sections[one_page.LIMITS][0]
    said = page.replace("χ", "chi").replace("≤", "<=").replace("π", "pi")
    for sentence in (*run_text.headline(study), *sheet.sections[one_page.LIMITS]):
        assert sentence in said
    assert sheet.errors == {"masking error": study.chi}


def test_the_sheet_of_an_earlier_run_goes(tmp_path):
    save(duffing(500), tmp_path)
    masking.report(tmp_path, one_page=True)
    save(duffing(500), tmp_path)
    assert not list(tmp_path.glob("one_page.*"))


def holding(folder, **files):
    """Return a folder with some JSON."""
    for name, content in files.items():
        (folder / f"{name}.json").write_text(content, encoding="utf-8")
    return folder


@pytest.mark.parametrize(
    ("files", "said"),
    [
        ({}, "is no result; name a folder that holds recording.parquet, discovery.json, fit.json or learning.json"),
        ({"discovery": "{}", "fit": "{}"}, "holds several results; name one of them: "),
        ({"fit": "{"}, "fit.json is no JSON: "),
        ({"fit": "[1]"}, "must be an object, not [1]; name a file that this version of masking wrote"),
        ({"fit": "{}"}, "the key 'sheet' is missing; name a file that this version of masking wrote, or make the"),
        ({"fit": '{"sheet": {"title": 3}}'}, "sheet.title: must be a text, not 3"),
        ({"fit": json.dumps({"sheet": {"title": "", "tiles": [[]], "subject": []}})}, "sheet."),
    ],
)
def test_a_folder_without_one_result_is_refused(tmp_path, files, said):
    with pytest.raises(RecordError, match=re.escape(said)):
        masking.report(holding(tmp_path, **files), out=tmp_path / "out", one_page=True)
    assert not (tmp_path / "out").exists()
    assert {path.name for path in tmp_path.iterdir()} == {f"{name}.json" for name in files}


def test_one_of_several_results_is_named(tmp_path):
    content = json_text({"sheet": PLAIN})
    holding(tmp_path, discovery=content, fit=content)
    assert masking.report(tmp_path / "fit.json", one_page=True).summary == PLAIN.title
    with pytest.raises(RecordError, match=r"nothing\.json is no result"):
        masking.report(tmp_path / "nothing.json", one_page=True)


def test_another_sheet_is_replaced_only_on_demand(tmp_path, capsys):
    holding(tmp_path, fit=json_text({"sheet": PLAIN}))
    given = ["report", str(tmp_path), "--one-page", "--out", str(tmp_path / "out")]
    assert main(given) == 0
    assert main(given) == 2
    assert "holds an earlier result, one_page.pdf" in capsys.readouterr().err
    assert main([*given, "--overwrite"]) == 0
    (tmp_path / "file").write_text("", encoding="utf-8")
    assert main([*given[:-1], str(tmp_path / "file")]) == 2
    assert "file is a file; name a folder to save in" in capsys.readouterr().err
