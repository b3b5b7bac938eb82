"""Arrays for the page in their memory layout: a line of JSON that describes them, then their bytes.

A browser lays typed arrays over the bytes, which is faster than parsing a million numbers.
"""

import json
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

MEDIA_TYPE: Final = "application/octet-stream"

#: Every array starts at a multiple of this many bytes, as typed arrays require.
ALIGNMENT: Final = 8


def packed(attributes: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bytes:
    """A line `{..., "arrays": {name: [type, offset, length]}}`, then the arrays, little-endian.

    Offsets are in bytes from the end of the line; types are numpy's names (`float32`).
    """
    directory, body, offset = {}, [], 0
    for name, array in arrays.items():
        flat = np.ascontiguousarray(array, array.dtype.newbyteorder("<")).ravel()
        directory[name] = [array.dtype.name, offset, flat.size]
        body.append(flat.tobytes().ljust(-(-flat.nbytes // ALIGNMENT) * ALIGNMENT, b"\0"))
        offset += len(body[-1])
    document = {**attributes, "arrays": directory}
    line = json.dumps(document, allow_nan=False, separators=(",", ":")).encode()
    padded = -(-(len(line) + 1) // ALIGNMENT) * ALIGNMENT
    return b"".join([line.ljust(padded - 1), b"\n", *body])
