"""Reads results from the JSON of the service."""

import xarray

from service.client.dataset import from_binary


def from_json(body: bytes) -> xarray.Dataset:
    """The Dataset of a JSON document: the binary form without arrays behind its line."""
    return from_binary(body + b"\n")
