"""What the architecture promises to whoever adds a contact model: its module and a row of the table."""

from pathlib import Path

import pytest
import toy_model
from served import computing, finished, read
from studies import spec_of

from kernel.params import Outcome
from worker.spec.contact_models import CONTACT_MODELS
from worker.sweep import SweepSpec
from worker.sweep.plan import CHUNK_SECONDS, FOLLOWED_SHARE


@pytest.fixture
def glued(monkeypatch: pytest.MonkeyPatch):
    """The toy model in the table, and specifications that know it."""
    monkeypatch.setitem(CONTACT_MODELS, "glued", toy_model.ROW)
    SweepSpec.model_rebuild(force=True)
    yield
    monkeypatch.undo()
    SweepSpec.model_rebuild(force=True)


GLUED = spec_of((1.0, 3.0, 5), 0.5, [0.1, 0.2], model={"kind": "glued"}, window=(3, 2))


def test_a_contact_model_is_its_module_and_a_row(tmp_path: Path, glued: None):
    with computing(tmp_path) as client:
        cost = client.post("/v1/jobs", params={"validate_only": "true"}, json=GLUED).json()
        followed = 2 * GLUED["observe"]  # plate periods of a cell without a mode
        seconds = 10 * (5 + FOLLOWED_SHARE * followed) * 0.01e-6
        assert cost["core_seconds"] == pytest.approx(seconds + CHUNK_SECONDS, rel=1e-9)
        here = finished(client, GLUED)
        diagram = read(client, f"{here}/diagram", along="gamma", omega=0.5, xi=0.1)
        assert diagram.outcome.values.tolist() == [Outcome.AT_REST] * 5
        picture = client.get(f"{here}/diagram", params={"omega": 0.5, "xi": 0.1, "format": "svg"})
        assert picture.status_code == 200

        refused = client.post("/v1/jobs", json=GLUED | {"model": {"kind": "glued", "colour": "green"}})
        assert refused.status_code == 422
        assert refused.json()["errors"][0]["field"] == "model.colour"
        unknown = client.post("/v1/jobs", json=GLUED | {"model": {"kind": "glue"}})
        assert "did you mean 'glued'?" in unknown.json()["detail"]
