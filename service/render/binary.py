"""Numbers for the page as they lie in memory: a line of JSON that says what follows, then the arrays.

A browser lays its typed arrays over the bytes instead of reading a million numbers as text.
"""

import gzip
import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from fastapi import Response
from numpy.typing import NDArray

MEDIA_TYPE: Final = "application/octet-stream"

#: What every array's place is a multiple of, as typed arrays want it.
ALIGNMENT: Final = 8


def packed(facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A line `{..., "arrays": {name: [type, offset, length]}}`, then the arrays, little-endian.

    Offsets are in bytes from the end of the line, types are numpy's names (`float32`).
    """
    places, body, offset = {}, [], 0
    for name, array in arrays.items():
        flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).ravel()
        places[name] = [array.dtype.name, offset, flat.size]
        body.append(flat.tobytes().ljust(-(-flat.nbytes // ALIGNMENT) * ALIGNMENT, b"\0"))
        offset += len(body[-1])
    line = json.dumps({**facts, "arrays": places}, allow_nan=False, separators=(",", ":")).encode()
    whole = -(-(len(line) + 1) // ALIGNMENT) * ALIGNMENT
    return b"".join([line.ljust(whole - 1), b"\n", *body])


def answer(content: bytes, *, squeeze: bool) -> Response:
    """The packed bytes as an answer; `squeeze` if the caller accepts gzip and it is worth its time."""
    headers = {"Vary": "Accept-Encoding", "Cache-Control": "no-cache"}
    if squeeze:
        content, headers = gzip.compress(content, 1), {**headers, "Content-Encoding": "gzip"}
    return Response(content, 200, headers, MEDIA_TYPE)
