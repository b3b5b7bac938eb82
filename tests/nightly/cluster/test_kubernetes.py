"""docs/kubernetes.yaml against the schema of the Dask operator and the types of Kubernetes; no cluster.

pip install dask-kubernetes
pytest -n 0 tests/nightly/cluster/test_kubernetes.py
"""

import re
from importlib.resources import files
from typing import Any

import pytest
import yaml
from paths import ROOT

REASON = "needs the Dask operator's package: pip install dask-kubernetes"
pytest.importorskip("dask_kubernetes", reason=REASON)
models = pytest.importorskip("kubernetes.client.models", reason=REASON)
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


def check(value: Any, kind: str, where: str) -> None:
    """Raises where a value is no `kind` of the Python client's: its fields and what it requires."""
    if many := re.fullmatch(r"[lL]ist\[(.*)\]", kind):
        assert isinstance(value, list), where
        for number, each in enumerate(value):
            check(each, many[1], f"{where}[{number}]")
    elif of := re.fullmatch(r"[dD]ict[(\[]str, (.*)[)\]]", kind):
        assert isinstance(value, dict), where
        for name, each in value.items():
            check(each, of[1], f"{where}.{name}")
    elif (model := getattr(models, kind, None)) is not None:
        assert isinstance(value, dict), where
        fields = {json_name: name for name, json_name in model.attribute_map.items()}
        assert set(value) <= set(fields), f"{where}: {kind} has no {sorted(set(value) - set(fields))}"
        for json_name, each in value.items():
            check(each, model.openapi_types[fields[json_name]], f"{where}.{json_name}")
        model(**{fields[json_name]: each for json_name, each in value.items()})  # raises if one is missing
    else:
        python = {"str": str, "int": int, "bool": bool, "object": (str, int)}[kind]
        assert isinstance(value, python), f"{where}: {value!r} is no {kind}"
        assert kind == "bool" or not isinstance(value, bool), where


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
        check(cluster["spec"][part]["spec"], "V1PodSpec", part)


@pytest.mark.parametrize(
    "thing",
    [thing for thing in OBJECTS if thing["kind"] != "DaskCluster"],
    ids=lambda thing: f"{thing['kind']} {thing['metadata']['name']}",
)
def test_an_object_is_one_of_kubernetes(thing: dict[str, Any]):
    model = f"{thing['apiVersion'].rpartition('/')[2].capitalize()}{thing['kind']}"
    check(thing, model, thing["kind"])
    with pytest.raises(AssertionError, match="has no"):
        check(thing | {"spec": thing["spec"] | {"slip": 1}}, model, thing["kind"])
