"""Matrices (4, 4) and vectors (4,), float64, written out: LAPACK's last digits depend on the machine."""

import math
from typing import Any, Final

import numpy as np

from kernel.numerics.jit import allocating, jit
from kernel.portable_math import atan2, hypot

SQUARINGS: Final = 30  # leave only the largest of eigenvalues that differ by more than 1e-8, relative
DOUBLINGS: Final = 40  # most doublings of the terms of `contracting_norm`, to 2**40
NEGLIGIBLE: Final = 1e-6  # part of the norm below which the last half of the terms ends the sum
REAL: Final = 1e-8  # relative residual below which a vector is an eigenvector, of a real eigenvalue
VANISHES: Final = 1e-300  # an eigenvalue of this modulus is zero, whose angle is zero


@jit
def multiply(a: Any, b: Any, product: Any) -> None:
    """Overwrite `product` with a b, four columns at once."""
    for i in range(4):
        x, y, z, w = 0.0, 0.0, 0.0, 0.0
        for k in range(4):
            x, y = x + a[i, k] * b[k, 0], y + a[i, k] * b[k, 1]
            z, w = z + a[i, k] * b[k, 2], w + a[i, k] * b[k, 3]
        product[i, 0], product[i, 1], product[i, 2], product[i, 3] = x, y, z, w


@jit
def transpose(a: Any, transposed: Any) -> None:
    """Overwrite `transposed` with a^T."""
    for i in range(4):
        for j in range(4):
            transposed[i, j] = a[j, i]


@jit
def scale_to(a: Any, factor: float, product: Any) -> None:
    """Overwrite `product` with `factor` times a."""
    for i in range(4):
        for j in range(4):
            product[i, j] = factor * a[i, j]


@jit
def set_identity(a: Any) -> None:
    """Overwrite `a` with the identity."""
    for i in range(4):
        for j in range(4):
            a[i, j] = 1.0 if i == j else 0.0


@jit
def trace(a: Any) -> float:
    """The sum of the eigenvalues."""
    total: float = a[0, 0] + a[1, 1] + a[2, 2] + a[3, 3]
    return total


@jit
def apply(a: Any, x: Any, product: Any) -> None:
    """Overwrite the vector `product` with a x."""
    for i in range(4):
        product[i] = a[i, 0] * x[0] + a[i, 1] * x[1] + a[i, 2] * x[2] + a[i, 3] * x[3]


@jit
def dot(x: Any, y: Any) -> float:
    """The scalar product of two vectors."""
    product: float = x[0] * y[0] + x[1] * y[1] + x[2] * y[2] + x[3] * y[3]
    return product


@jit
def largest(x: Any) -> float:
    """The largest absolute value of a vector's elements; NaN if the last is, as of a failed `solve`."""
    value = 0.0
    for i in range(4):
        if not abs(x[i]) <= value:
            value = abs(x[i])
    return value


@jit
def solve(a: Any, b: Any) -> None:
    """Overwrite b with the solution x of a x = b, by elimination; not finite where a is singular.

    Overwrites a too.
    """
    for column in range(4):
        pivot = column
        for row in range(column + 1, 4):
            if abs(a[row, column]) > abs(a[pivot, column]):
                pivot = row
        for k in range(4):
            a[column, k], a[pivot, k] = a[pivot, k], a[column, k]
        b[column], b[pivot] = b[pivot], b[column]
        for row in range(column + 1, 4):
            factor = a[row, column] / a[column, column]
            for k in range(column, 4):
                a[row, k] -= factor * a[column, k]
            b[row] -= factor * b[column]
    for row in range(3, -1, -1):
        for k in range(row + 1, 4):
            b[row] -= a[row, k] * b[k]
        b[row] /= a[row, row]


@allocating
def leading_eigenvalue(a: Any) -> tuple[float, float]:
    """Modulus and angle (rad, 0 to pi) of the eigenvalue of largest modulus.

    High powers of `a` map every vector to the directions that belong to it: one, or two of a complex pair.
    """
    power, square, x, y, image = np.empty((4, 4)), np.empty((4, 4)), np.empty(4), np.empty(4), np.empty(4)
    scale_to(a, 1.0, square)
    for _ in range(SQUARINGS):
        size = 0.0
        for i in range(4):
            size = max(size, largest(square[i]))
        if not size > 0.0:
            return size, 0.0
        scale_to(square, 1.0 / size, power)
        multiply(power, power, square)
    best, longest = 0, 0.0
    for j in range(4):
        for i in range(4):
            x[i] = square[i, j]
        if dot(x, x) > longest:
            best, longest = j, dot(x, x)
    for i in range(4):
        x[i] = square[i, best] / math.sqrt(longest)
    apply(a, x, image)
    xx, size = dot(x, image), math.sqrt(dot(image, image))
    for i in range(4):
        y[i] = image[i] - xx * x[i]
    yx = math.sqrt(dot(y, y))
    if not yx > REAL * size:
        return _polar(xx, 0.0)
    for i in range(4):
        y[i] /= yx
    apply(a, y, image)
    xy, yy = dot(x, image), dot(y, image)
    half, discriminant = 0.5 * (xx + yy), 0.25 * (xx - yy) * (xx - yy) + xy * yx
    root = math.sqrt(abs(discriminant))
    if discriminant < 0.0:
        return _polar(half, root)
    return _polar(half - root if half < 0.0 else half + root, 0.0)


@jit
def _polar(re: float, im: float) -> tuple[float, float]:
    """Modulus and angle of a number with im >= 0."""
    modulus = hypot(re, im)
    return modulus, atan2(im, re) if modulus > VANISHES else 0.0


@allocating
def contracting_norm(a: Any, r: float, q: Any) -> None:
    """Overwrite q, so that |a x| <= r |x| in the norm |x|**2 = x q x, for r above all eigenvalues' moduli.

    q is the sum of (a^T/r)**j (a/r)**j over all j, summed by doubling the number of terms.
    """
    power, transposed, product, added = np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4)), np.empty((4, 4))
    set_identity(q)
    scale_to(a, 1.0 / r, power)
    for _ in range(DOUBLINGS):
        multiply(q, power, product)
        transpose(power, transposed)
        multiply(transposed, product, added)
        for i in range(4):
            for j in range(4):
                q[i, j] += added[i, j]
        if trace(added) < NEGLIGIBLE * trace(q):
            break
        multiply(power, power, product)
        scale_to(product, 1.0, power)
