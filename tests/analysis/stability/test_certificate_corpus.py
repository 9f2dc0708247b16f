"""Certificates of models whose truth is known from elsewhere: none is wrong, most truths are proved."""

from functools import cache

import numpy as np
import pytest

from masking.analysis.stability.energy_certificate import certificate
from tests.benchmarks.certificates.comparison import proved, wrong
from tests.benchmarks.certificates.entry import NONE
from tests.benchmarks.certificates.models import CORPUS
from tests.benchmarks.certificates.truth import Truth
from tests.conftest import declare

QUICK = [
    name
    for name, entry in CORPUS.items()
    if len(entry.coordinates) == 1 and entry.duration <= 120.0 and not entry.is_rough
]


@cache
def examined(name):
    """Return what contradicts the truth of an entry, what is wrong in its certificate, and how much it proves."""
    truth = Truth(CORPUS[name])
    found = certificate(declare(**CORPUS[name].declaration))
    return truth.mismatch(), wrong(found, truth), proved(found, truth)


@pytest.mark.parametrize("name", QUICK)
def test_no_certificate_of_one_coordinate_is_wrong(name):
    mismatch, slip, _ = examined(name)
    assert not mismatch
    assert not slip


@pytest.mark.search
@pytest.mark.parametrize("name", [name for name in CORPUS if name not in QUICK])
def test_no_certificate_is_wrong(name):
    mismatch, slip, _ = examined(name)
    assert not mismatch
    assert not slip


@pytest.mark.search
def test_most_of_what_is_true_of_all_motions_is_proved():
    known = [name for name, entry in CORPUS.items() if entry.truth != NONE]
    assert len(CORPUS) >= 60
    assert sum(examined(name)[2] == "all" for name in known) >= 40


def test_the_truth_is_that_of_closed_forms():
    """The truth's simulations and eigenvalues against cos(t), and exp(-0.1 t) cos(w t) with w^2 = 1 - 0.01."""
    truth = Truth(CORPUS["one oscillator"])
    values, _ = truth.eigenvalues([0.0])
    np.testing.assert_allclose(sorted(values.imag), [-np.sqrt(0.99), np.sqrt(0.99)], rtol=1e-12)
    np.testing.assert_allclose(values.real, -0.1, rtol=1e-12)
    path, t = truth.motion([1.0, -0.1]), np.linspace(0.0, 120.0, 801)
    np.testing.assert_allclose(path[:, 0], np.exp(-0.1 * t) * np.cos(np.sqrt(0.99) * t), atol=1e-9)
    path = Truth(CORPUS["pendulum"]).motion([0.001, 0.0])
    np.testing.assert_allclose(path[:, 0], 0.001 * np.cos(t), atol=2e-7)  # its frequency is 1 - 0.001^2/16
