"""The update by information and the textbook's gain are the same update; only their cost differs."""

from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[3]


@pytest.mark.parametrize("points", [1, 30, 400])
def test_information_form_equals_the_textbook_gain(points, monkeypatch):
    monkeypatch.syspath_prepend(ROOT)
    from benchmarks.blind import _by_gain, _by_information

    rng = np.random.default_rng(points)
    P = np.diag(rng.uniform(0.01, 1.0, 24))
    H, r = rng.normal(size=(points, 24)), rng.normal(size=points)
    np.testing.assert_allclose(_by_information(P, H, r), _by_gain(P, H, r), rtol=1e-6, atol=1e-9)
