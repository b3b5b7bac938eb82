"""The API document: valid, with names that a person would choose, and enough to generate a client from."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from extras import SYSTEM
from tables import for_each

from service.api import openapi
from service.api.app import create_app
from service.api.openapi import EXAMPLES
from service.api.schemas import NewName
from service.formats import EXPORTS, MEDIA_TYPES
from service.settings import Settings
from service.views.trajectory import TrajectorySpec
from worker.executors.inline import Inline
from worker.studies import from_json


def document_of(folder: Path, **settings: Any) -> dict[str, Any]:
    executor = Inline()
    try:
        return create_app(Settings(data=folder, **settings), executor).openapi()
    finally:
        executor.close()


@pytest.fixture(scope="module")
def document(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return document_of(tmp_path_factory.mktemp("data"))


def operations(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [operation for methods in document["paths"].values() for operation in methods.values()]


def test_it_is_valid_and_of_the_version_it_names(document: dict[str, Any]):
    assert document["openapi"].startswith("3.1.")
    assert "itemSchema" not in json.dumps(document)  # of 3.2, which the validator does not know
    validator = pytest.importorskip("openapi_spec_validator", reason=SYSTEM)
    validator.OpenAPIV31SpecValidator(document).validate()


def test_every_operation_has_a_name_of_its_own_and_a_tag(document: dict[str, Any]):
    tags = {tag["name"] for tag in document["tags"]}
    names = [operation["operationId"] for operation in operations(document)]
    assert len(set(names)) == len(names) > 20
    assert all(re.fullmatch("[a-z]+(_[a-z]+)+", name) for name in names)
    assert {tag for operation in operations(document) for tag in operation["tags"]} == tags


def test_every_error_is_a_problem_document(document: dict[str, Any]):
    for operation in operations(document):
        for status, answer in operation["responses"].items():
            if status >= "4":
                assert list(answer["content"]) == ["application/problem+json"], operation["operationId"]


def test_files_have_their_types_and_parquet_may_be_missing(document: dict[str, Any]):
    export = document["paths"]["/v1/jobs/{job_id}/export"]["get"]["responses"]
    assert sorted(export["200"]["content"]) == sorted(MEDIA_TYPES[format] for format in EXPORTS)
    for operation in operations(document):
        for answer in operation["responses"].values():
            if MEDIA_TYPES["parquet"] in answer.get("content", {}):
                assert "501" in operation["responses"], operation["operationId"]


def test_the_fields_of_a_sweep_have_meanings_and_defaults(document: dict[str, Any]):
    schema = document["components"]["schemas"]["SweepSpec"]
    for name, field in schema["properties"].items():
        if name == "name":
            continue
        assert field["description"].endswith("."), name
        assert name in schema["required"] or "default" in field or "Default: " in field["description"], name
    assert schema["properties"]["observe"]["minimum"] == 1


@for_each("model", EXAMPLES)
def test_examples_are_accepted(document: dict[str, Any], model: Any):
    (example,) = document["components"]["schemas"][model.__name__]["examples"]
    text = json.dumps(example)
    if model is NewName:
        model.from_json(text)
    elif model is TrajectorySpec:
        TrajectorySpec(**json.loads(text))
    else:
        assert type(from_json(text)) is model


@pytest.mark.parametrize("token", [None, "a-token-of-the-service"])
def test_it_says_whether_a_token_is_needed(tmp_path: Path, token: str | None):
    document = document_of(tmp_path, token=token)
    (scheme,) = document["components"]["securitySchemes"].values()
    assert (scheme["type"], scheme["scheme"]) == ("http", "bearer")
    assert document.get("security") == ([{"token": []}] if token else None)
    assert document["paths"]["/healthz"]["get"]["security"] == []
    assert "security" not in document["paths"]["/v1/jobs"]["post"]


def test_a_request_meanwhile_does_not_spoil_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """It may replace what FastAPI keeps of a model, where the document then finds nothing."""
    make, missing = openapi.get_openapi, [KeyError("a field")]

    def interrupted(**given: Any) -> dict[str, Any]:
        if missing:
            raise missing.pop()
        return make(**given)

    monkeypatch.setattr(openapi, "get_openapi", interrupted)
    assert "/v1/jobs" in document_of(tmp_path)["paths"]
