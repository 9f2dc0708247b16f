"""The page of a playground: its motion is that of scipy, sliders keep to bounds, and strangers get nothing."""

import http.client
import json
import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from urllib.parse import urlencode, urlsplit

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import masking
from masking.errors import DeclarationError, MaskingError, ModelError, OperatorError
from masking.reports.play_page import Playground, PlayPage
from tests.support import chromium

SPRING = """
name: <spring>
coordinates: {x: {meaning: displacement, unit: mm, initial: 1}}
inputs: {F: {unit: N}}
parameters:
  m: {value: 0.5, unit: kg, bounds: [0.1, null], meaning: <b>mass</b>}
  k: {value: 200, unit: N/m}
  c: {value: "0.02*k", unit: N*s/m}
equations: {m*x'': F - c*x' - k*x}
"""


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    file = tmp_path_factory.mktemp("spring") / "spring.yaml"
    file.write_text(SPRING.replace('"0.02*k"', "2"), encoding="utf-8")
    return masking.load_model(file)


@pytest.fixture(scope="module")
def page(model):
    with PlayPage(Playground(model)) as made:
        yield made


def get(address):
    with urllib.request.urlopen(address, timeout=20) as answer:  # noqa: S310  # our own page
        return answer.read().decode(), answer.headers


def asked(page, **values):
    return json.loads(get(f"{page.address}data?{urlencode(values)}")[0])


def test_the_motion_is_that_of_another_integrator_in_declared_units(model):
    values = {"k": 300.0, "x": 2.0, "x'": -5.0, "F": 0.1, "duration": 1.0}
    found = Playground(model).motion(values)
    m, c = 0.5, 2.0
    other = solve_ivp(
        lambda t, y: [y[1], (0.1 - c * y[1] - 300.0 * y[0]) / m], (0.0, 1.0), [2e-3, -5e-3],
        t_eval=found["t"], rtol=1e-9, atol=1e-12,
    )  # fmt: skip
    assert found["states"]["x"] == pytest.approx(1e3 * other.y[0], abs=1e-4)
    assert found["states"]["x'"] == pytest.approx(1e3 * other.y[1], abs=1e-3)


def test_sliders_keep_to_bounds_and_show_some_periods(model):
    sliders = Playground(model).sliders
    assert [*sliders] == ["m", "k", "c", "x", "x'", "F", "duration"]
    assert (sliders["m"].least, sliders["m"].most, sliders["m"].value) == (0.1, 1.5, 0.5)
    assert sliders["k"].least == 0.0
    assert sliders["x"].unit == "mm"
    assert sliders["x'"].unit == "mm/s"
    assert all(one.least <= one.value <= one.most for one in sliders.values())
    assert 5.0 < sliders["duration"].value * np.sqrt(200.0 / 0.5) / (2.0 * np.pi) < 50.0
    assert Playground(model, 3.0).sliders["duration"].value == 3.0


@pytest.mark.parametrize("name", ["duffing", "huygens", "bouc_wen", "delayed_oscillators", "bouncing_ball"])
def test_packaged_models_move(name):
    playground = Playground(masking.load_model(name))
    found = playground.motion({})
    assert found["states"].keys() == set(playground.model.state_names)
    json.dumps(found, allow_nan=False)


def test_values_that_make_no_sense_are_refused_in_words(model):
    playground = Playground(model)
    for values, words in (
        ({"kk": 1.0}, r"no slider 'kk'; did you mean 'k'"),
        ({"k": np.nan}, "k = nan is not finite"),
        ({"duration": 0.0}, "a duration of 0 is not shown"),
        ({"duration": 1e9}, "a duration of 1e\\+09 is not shown"),
    ):
        with pytest.raises(ModelError, match=words):
            playground.motion(values)
    with pytest.raises(DeclarationError, match="m = 0"):
        playground.motion({"m": 0.0})
    with pytest.raises(ModelError, match="give a positive number"):
        Playground(model, -1.0)


def test_the_page_answers_with_a_motion_or_an_error_and_escapes_names(page, model):
    text, headers = get(page.address)
    assert "<b>mass" not in text
    assert "&lt;b&gt;mass" in text
    assert "frame-ancestors 'self' http://127.0.0.1:*" in headers["Content-Security-Policy"]
    assert headers["X-Frame-Options"] is None
    assert asked(page, k=100.0)["states"] == Playground(model).motion({"k": 100.0})["states"]
    assert "no slider 'q'" in asked(page, q=1.0)["error"]
    assert "does not give numbers" in asked(page, k="one")["error"]
    assert page.address in page._repr_html_()
    assert repr(page) == f"<PlayPage <spring>: {page.address}>"


def test_strangers_get_nothing_and_a_taken_port_is_named(page, model):
    parts = urlsplit(page.address)
    with pytest.raises(urllib.error.HTTPError, match="404"):
        get(f"http://{parts.netloc}/guess/")
    connection = http.client.HTTPConnection(parts.netloc, timeout=20)
    connection.request("GET", parts.path, headers={"Host": "evil.example"})
    assert connection.getresponse().status == 404
    with pytest.raises(OperatorError, match=rf"--port {parts.port}: this port cannot be had"):
        masking.play(model, port=parts.port)


def test_a_model_that_cannot_move_is_refused_before_there_is_a_page(tmp_path):
    file = tmp_path / "off.yaml"
    file.write_text("name: off\ncoordinates: {x: {initial: 1}}\nequations: {x'': x**3 + x'**3}\n", encoding="utf-8")
    with pytest.raises(MaskingError):
        masking.play(file, duration=1e3)


@pytest.mark.skipif(os.name == "nt", reason="POSIX signals")
def test_the_verb_serves_the_page_until_an_interrupt(tmp_path):
    command = [sys.executable, "-P", "-m", "masking", "play", "van_der_pol", "--duration", "30", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path)
    try:
        text = process.stdout.readline() + process.stdout.readline() + process.stdout.readline()
        answer = get(f"{json.loads(text)['page']}data?")[0]
        assert json.loads(answer)["t"][-1] == 30.0
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 130
    assert said.splitlines()[-1] == "masking: the page has ended"
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def tab():
    if chromium.PATH is None:
        pytest.skip("there is no Chromium")
    with chromium.browsing() as found:
        yield found


@pytest.mark.parametrize("width", [1280, 420])
def test_a_slider_redraws_the_motion_in_a_browser(tab, model, width):
    with PlayPage(Playground(model)) as page:
        tab.open(page.address, width=width, height=900)
        tab.wait_for("document.readyState === 'complete' && motion.t.length")
        assert tab.value("document.documentElement.scrollWidth <= innerWidth")
        ink = "panels[0].canvas.toDataURL()"
        before, first = tab.value("JSON.stringify(motion.states.x)"), tab.value(ink)
        assert json.loads(before) == Playground(model).motion({})["states"]["x"]
        moved = "form.elements.k.dispatchEvent(new Event('input', {bubbles: true}))"
        tab.value(f"(() => {{ form.elements.k.value = 400; {moved} }})()")
        tab.wait_for(f"JSON.stringify(motion.states.x) !== {json.dumps(before)}")
        assert tab.value("motion.states.x") == Playground(model).motion({"k": 400.0})["states"]["x"]
        assert tab.value(ink) != first
        assert tab.value("form.elements.k.nextElementSibling.textContent") == "400 N/m"
        tab.value("form.querySelector('button').click()")
        tab.wait_for(f"JSON.stringify(motion.states.x) === {json.dumps(before)}")
        assert tab.value("form.elements.k.nextElementSibling.textContent") == "200 N/m"
        assert [one for one in tab.events if one.get("method") == "Runtime.exceptionThrown"] == []
    tab.value("form.elements.k.dispatchEvent(new Event('input', {bubbles: true}))")
    tab.wait_for("trouble.textContent.includes('has ended')")
