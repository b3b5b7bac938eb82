"""docs/kubernetes.yaml against the schema of the Dask operator and the types of Kubernetes; no cluster.

pip install dask-kubernetes
pytest -n 0 tests/nightly/cluster/test_kubernetes.py
"""

import json
from importlib.resources import files
from typing import Any

import pytest
import yaml
from paths import ROOT

REASON = "needs the Dask operator's package: pip install dask-kubernetes"
pytest.importorskip("dask_kubernetes", reason=REASON)
kubernetes = pytest.importorskip("kubernetes.client", reason=REASON)
jsonschema = pytest.importorskip("jsonschema")  # check-jsonschema's

OBJECTS: list[dict[str, Any]] = list(yaml.safe_load_all((ROOT / "docs" / "kubernetes.yaml").read_text()))
CRDS = "operator/deployment/helm/dask-kubernetes-operator/crds"


def closed(schema: Any) -> Any:
    """A schema that takes no fields beyond those that it names, as `kubectl apply` does."""
    if isinstance(schema, list):
        return [closed(each) for each in schema]
    if not isinstance(schema, dict):
        return schema
    strict = {name: closed(value) for name, value in schema.items()}
    if isinstance(schema.get("properties"), dict) and "additionalProperties" not in schema:
        strict["additionalProperties"] = bool(schema.get("x-kubernetes-preserve-unknown-fields"))
    return strict


def as_understood(value: Any, kind: str) -> Any:
    """What Kubernetes' client makes of a value: a field is lost that the kind has not; others are checked."""
    client = kubernetes.ApiClient()
    return client.sanitize_for_serialization(client.deserialize(json.dumps(value), kind, "application/json"))


def test_the_cluster_is_one_of_the_operator():
    """The operator's schema lets more pods pass than Kubernetes does."""
    (cluster,) = (thing for thing in OBJECTS if thing["kind"] == "DaskCluster")
    assert cluster["apiVersion"] == "kubernetes.dask.org/v1"
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    definition = yaml.load((files("dask_kubernetes") / CRDS / "daskcluster.yaml").read_text(), loader)
    (version,) = definition["spec"]["versions"]
    schema = closed(version["schema"]["openAPIV3Schema"]["properties"]["spec"])
    jsonschema.validate(cluster["spec"], schema)
    with pytest.raises(jsonschema.ValidationError, match="replica"):
        jsonschema.validate(cluster["spec"] | {"worker": cluster["spec"]["worker"] | {"replica": 2}}, schema)
    for part in ("scheduler", "worker"):
        pod = cluster["spec"][part]["spec"]
        assert as_understood(pod, "V1PodSpec") == pod


@pytest.mark.parametrize(
    "thing",
    [thing for thing in OBJECTS if thing["kind"] != "DaskCluster"],
    ids=lambda thing: f"{thing['kind']} {thing['metadata']['name']}",
)
def test_an_object_is_one_of_kubernetes(thing: dict[str, Any]):
    model = f"{thing['apiVersion'].rpartition('/')[2].capitalize()}{thing['kind']}"
    slipped = thing | {"spec": thing["spec"] | {"slip": 1}}
    assert as_understood(thing, model) == as_understood(slipped, model) == thing
