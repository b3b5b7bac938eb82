"""Room: a store without chunks: its metadata and coordinates, the same bytes every time."""

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
import zarr
from zarr.codecs import ZstdCodec
from zarr.core.buffer import Buffer, default_buffer_prototype
from zarr.storage import MemoryStore

from kernel.params import KERNEL_VERSION
from worker import schema
from worker.plan import Plan
from worker.spec import SweepSpec
from worker.spec.contact_models import Stepped
from worker.spec.time_steps import corners, stated
from worker.store.reader import ROOT

_CODEC: Final = ZstdCodec(level=3, checksum=True)


def skeleton(spec: SweepSpec, plan: Plan, attrs: Mapping[str, Any]) -> dict[str, Buffer]:
    """Every file or object of an empty store by its address, with `attrs` beside our own."""
    content: dict[str, Buffer] = {}
    store = MemoryStore(content)
    group = zarr.open_group(store, mode="w", zarr_format=3)
    for coordinate in schema.COORDINATES:
        _create_coordinate(group, coordinate, spec)
    for array in schema.arrays(spec):
        _create_array(group, array, spec, plan)
    group.attrs.put({**_provenance(spec), **attrs, **identity(spec, plan)})
    content[ROOT] = _consolidated(content)
    return content


def _consolidated(content: Mapping[str, Buffer]) -> Buffer:
    """The root's metadata with that of every array in it, as `zarr.consolidate_metadata` writes it.

    That function warns that consolidated metadata is not in the specification of zarr v3. Warning filters
    belong to the whole process, so no thread of the service can suppress the warning safely.
    """
    root = json.loads(content[ROOT].to_bytes())
    names = sorted(path.removesuffix(f"/{ROOT}") for path in content if path.endswith(f"/{ROOT}"))
    arrays = {name: json.loads(content[f"{name}/{ROOT}"].to_bytes()) for name in names}
    consolidated = {"kind": "inline", "must_understand": False, "metadata": arrays}
    # The order of the fields is zarr's: stores that exist were written with it.
    root |= {"consolidated_metadata": consolidated, "node_type": root.pop("node_type")}
    text = json.dumps(root, indent=zarr.config.get("json_indent"))
    return default_buffer_prototype().buffer.from_bytes(text.encode())


def identity(spec: SweepSpec, plan: Plan) -> dict[str, Any]:
    """What tells this store from any other."""
    return {"job": spec.job_id(KERNEL_VERSION), "chunk_shape": list(plan.chunk_shape)}


def _provenance(spec: SweepSpec) -> dict[str, Any]:
    said = {
        "Conventions": "CF-1.11",
        "title": spec.name or "bouncing spring",
        "kernel_version": KERNEL_VERSION,
        "model": spec.model.kind,
        "spec": spec.as_submitted(),
    }
    if isinstance(spec.model, Stepped):
        axes = (spec.axis_values(axis) for axis in ("gamma", "omega", "xi"))
        said["time_steps"] = stated(spec.model, corners(*axes))
    return said


def _create_coordinate(group: zarr.Group, coordinate: schema.Coordinate, spec: SweepSpec) -> None:
    name = coordinate.name
    # Variable-length text: zarr has no stable form for the fixed-length one.
    values = (
        np.array(spec.directions, dtype=np.dtypes.StringDType())
        if name == "direction"
        else spec.axis_values(name).astype("<f8")
    )
    array = group.create_array(
        name, shape=values.shape, chunks=values.shape, dtype=values.dtype, compressors=_CODEC,
        dimension_names=(name,), attributes=coordinate.attrs,
    )  # fmt: skip
    array[:] = values


def _create_array(group: zarr.Group, array: schema.Array, spec: SweepSpec, plan: Plan) -> None:
    length = schema.sizes(spec)
    extra = tuple(length[dim] for dim in array.extra_dims)
    group.create_array(
        array.name, shape=(*spec.shape, *extra), chunks=(1, *plan.chunk_shape, *extra), dtype=array.dtype,
        fill_value=array.fill, compressors=_CODEC, dimension_names=array.dims, attributes=array.attrs,
    )  # fmt: skip
