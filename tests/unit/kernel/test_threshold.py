"""The bouncing threshold: the facts of docs/model.md, section 5, and a naive search for the onset."""

import json
import math

import numpy as np
import pytest
from paths import GOLDEN
from tables import for_each

from kernel.threshold import threshold

FACTS = json.loads((GOLDEN / "facts.json").read_text())["threshold"]
XI = [0.01, 0.05, 0.2, 0.3, 1.0, 10.0, 1e3]


@for_each("xi", [0.01, 0.05, 0.2, 1.0, 30.0])
@for_each("omega", [1e-3, 0.1, 0.5, 0.99, 1.0, math.sqrt(4 / 3), math.sqrt(2.0), 2.0, 40.0])
def test_eq_25_is_the_onset(omega, xi):
    """Of a mass that rides the plate: where the least n = 1/Gamma - cos(phi) - b q' - w q is zero."""
    w, b = 1.0 / omega**2, 2.0 * xi / omega
    phi = np.linspace(0.0, 2.0 * math.pi, 400_001)
    wave = np.exp(1j * phi) / complex(w - 1.0, b)
    # q = -1/(Gamma w) + Re(wave): the static part adds another 1/Gamma
    loss = np.cos(phi) + b * (1j * wave).real + w * wave.real
    assert threshold(omega, xi) == pytest.approx(2.0 / float(loss.max()), rel=1e-9)


@for_each("xi", XI)
def test_closed_forms_at_resonance_and_at_the_square_root_of_two(xi):
    assert threshold(1.0, xi) == pytest.approx(4.0 * xi / math.sqrt(1.0 + 16.0 * xi**2), rel=1e-13)
    assert threshold(math.sqrt(2.0), xi) == pytest.approx(math.sqrt(1.0 + 1.0 / (8.0 * xi**2)), rel=1e-13)


def test_facts():
    for which in ("least", "most"):
        omega, gamma = FACTS["extrema"][which]
        assert threshold(omega, FACTS["extrema"]["xi"]) == pytest.approx(gamma, abs=1e-5)
    for omega, gamma in FACTS["not_one_at_xi_one"]:
        assert threshold(omega, 1.0) == pytest.approx(gamma, abs=5e-4)
