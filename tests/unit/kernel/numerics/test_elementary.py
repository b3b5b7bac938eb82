"""Elementary functions against 50 digits and more; nothing in the kernel calls those of the C library."""

import ast
import math
import struct
from itertools import product
from pathlib import Path

import mpmath
import numpy as np
from tables import for_each

import kernel
from kernel import portable_math
from kernel.numerics import elementary
from kernel.numerics.jit import jit

COUNT = 300

#: What is exact or correctly rounded on every machine, or a constant.
PORTABLE = {"ceil", "copysign", "e", "fabs", "floor", "frexp", "inf", "isfinite", "isinf", "isnan", "ldexp"}
PORTABLE |= {"nan", "pi", "sqrt"}
#: numpy's functions that are not: its own, or the C library's.
NOT_PORTABLE = {"arccos", "arccosh", "arcsin", "arcsinh", "arctan", "arctan2", "arctanh", "cos", "cosh"}
NOT_PORTABLE |= {"exp", "exp2", "expm1", "float_power", "hypot", "log", "log10", "log1p", "log2", "logaddexp"}
NOT_PORTABLE |= {"logspace", "geomspace", "power", "sin", "sinc", "sinh", "tan", "tanh", "unwrap", "angle"}


def units(value, exact):
    """|value - exact| in units in the last place of the exact value."""
    place = np.spacing(abs(float(exact)))
    return float(abs(mpmath.mpf(value) - exact) / mpmath.mpf(place))


def any_doubles(rng, count=COUNT):
    """Positive numbers of every exponent, and subnormal ones."""
    bits = rng.integers(1, 0x7FE0000000000000, count).tolist()
    bits += rng.integers(1, 2**52, 20).tolist()
    return [struct.unpack("d", struct.pack("q", n))[0] for n in bits]


#: The functions as compiled code calls them.
COMPILED = {
    "log": jit(portable_math.log),
    "log1p": jit(portable_math.log1p),
    "exp": jit(portable_math.exp),
    "asinh": jit(portable_math.asinh),
    "hypot": jit(portable_math.hypot),
    "atan2": jit(portable_math.atan2),
}


def arguments_of(name, rng):
    """Arguments over the whole range of a function of one argument, and where it is delicate."""
    match name:
        case "log":
            return [*any_doubles(rng), *np.exp(rng.normal(size=COUNT) * 10 ** rng.uniform(-12, 0, COUNT))]
        case "log1p":
            return [*rng.uniform(-0.999, 1, COUNT), *10 ** rng.uniform(-300, 300, COUNT),
                    *-(10 ** rng.uniform(-300, -1e-9, COUNT))]  # fmt: skip
        case "exp":
            return [
                *rng.uniform(-745, 709.7, COUNT),
                *rng.normal(size=COUNT),
                *10 ** rng.uniform(-20, 0, COUNT),
            ]
        case "asinh":
            return [*10 ** rng.uniform(-300, 300, COUNT), *-(10 ** rng.uniform(-3, 1, COUNT))]
        case _:
            return any_doubles(rng)


@for_each("name", ["log", "log1p", "exp", "asinh"])
def test_one_argument_to_two_units_in_the_last_place(name):
    function, exact = getattr(portable_math, name), getattr(mpmath, name)
    with mpmath.workdps(360):  # 1 + 1e-300 needs so many
        for x in map(float, arguments_of(name, np.random.default_rng(1))):
            assert units(function(x), exact(mpmath.mpf(x))) <= 2.0, x


def test_expm1_to_two_units_in_the_last_place():
    rng = np.random.default_rng(2)
    with mpmath.workdps(360):
        for x in (*-(10 ** rng.uniform(-300, 2.84, COUNT)), *rng.uniform(-3, 0, COUNT)):
            assert units(elementary.expm1(float(x)), mpmath.expm1(mpmath.mpf(float(x)))) <= 2.0, x
    assert elementary.expm1(0.0) == 0.0
    assert elementary.expm1(-1e9) == -1.0


def pairs(rng):
    """Two numbers of like sizes, of any sizes, and of like sizes anywhere in the range."""
    yield from rng.normal(size=(COUNT, 2))
    large = any_doubles(rng)
    yield from zip(large, rng.permutation(large), strict=True)
    for x, ratio in zip(large, 10 ** rng.uniform(-9, 1, len(large)), strict=True):
        if x < 1e306:
            yield x, -x * ratio


def test_hypot_and_atan2_to_two_units_in_the_last_place():
    with mpmath.workdps(700):  # sums of squares of 1e-308 and 1e308 and the like
        for x, y in pairs(np.random.default_rng(3)):
            a, b = float(x), float(y)
            exact = mpmath.sqrt(mpmath.mpf(a) ** 2 + mpmath.mpf(b) ** 2)
            assert units(portable_math.hypot(a, b), exact) <= 2.0, (a, b)
            with mpmath.workdps(50):
                exact = mpmath.atan2(mpmath.mpf(b), mpmath.mpf(a))
            assert units(portable_math.atan2(b, a), exact) <= 2.0, (a, b)


def test_sincos_of_any_argument_to_two_units_in_the_last_place():
    rng = np.random.default_rng(5)
    nearest = math.ldexp(6381956970095103.0, 797)  # of all doubles the nearest to a multiple of pi/2
    with mpmath.workdps(360):
        for x in map(float, (*any_doubles(rng), *10 ** rng.uniform(5, 17, COUNT), nearest, -nearest)):
            sine, cosine = elementary.sincos(x)
            assert units(sine, mpmath.sin(mpmath.mpf(x))) <= 2.0, x
            assert units(cosine, mpmath.cos(mpmath.mpf(x))) <= 2.0, x
    for x in (math.inf, -math.inf, math.nan):
        assert np.isnan(elementary.sincos(x)).all()


SPECIAL = (0.0, -0.0, math.inf, -math.inf, math.nan, 5e-324, -5e-324, 1.0, -1.0, 1.7e308, -1.7e308, 0.5, 2.0)


@for_each(("name", "numpys", "arguments"), [
    ("log", "log", 1), ("log1p", "log1p", 1), ("exp", "exp", 1), ("asinh", "arcsinh", 1),
    ("hypot", "hypot", 2), ("atan2", "arctan2", 2),
])  # fmt: skip
def test_special_values(name, numpys, arguments):
    for x in product(SPECIAL, repeat=arguments):
        with np.errstate(all="ignore"):
            expected = getattr(np, numpys)(*x)
        value = getattr(portable_math, name)(*x)
        np.testing.assert_array_max_ulp(np.float64(value), expected, 2)
        same_sign = math.copysign(1.0, value) == math.copysign(1.0, expected)
        assert arguments == 1 or math.isnan(value) or same_sign, x


@for_each("name", COMPILED)
def test_compiled_code_gives_the_same_bytes_as_python(name):
    rng = np.random.default_rng(4)
    numbers = [*SPECIAL, *any_doubles(rng, 100), *rng.normal(size=100)]
    second = [(float(y),) for y in numbers[::7]] if name in {"hypot", "atan2"} else [()]
    for x in map(float, numbers):
        for rest in second:
            plain, machine = getattr(portable_math, name)(x, *rest), COMPILED[name](x, *rest)
            assert struct.pack("d", plain) == struct.pack("d", machine) or math.isnan(plain + machine), x


def violations(tree):
    """Lines of a module that call a function whose last digit depends on the machine."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "math" and node.attr not in PORTABLE:
                yield node.lineno, f"math.{node.attr}"
            if node.value.id in {"np", "numpy"} and node.attr in NOT_PORTABLE:
                yield node.lineno, f"np.{node.attr}"
        elif isinstance(node, ast.ImportFrom) and node.module in {"math", "cmath", "numpy"}:
            yield from ((node.lineno, f"from {node.module} import {name.name}") for name in node.names)
        elif isinstance(node, ast.Import) and any(name.name == "cmath" for name in node.names):
            yield node.lineno, "cmath"
        elif isinstance(node, ast.BinOp | ast.AugAssign) and isinstance(node.op, ast.Pow):
            power = node.right if isinstance(node, ast.BinOp) else node.value
            base = node.left if isinstance(node, ast.BinOp) else node.target
            whole = isinstance(power, ast.Constant) and isinstance(power.value, int)
            if not whole and not isinstance(base, ast.Constant):
                yield node.lineno, "a power that is not a constant integer"


#: All that sweeps compute with: no sweep depends on cycles, proofs and searches.
MODULES = sorted(
    path
    for path in Path(kernel.__path__[0]).rglob("*.py")
    if path.parent.name not in ("cycles", "proofs") and path.name not in ("creep.py", "search.py")
)


@for_each("module", [str(m.relative_to(kernel.__path__[0])) for m in MODULES])
def test_no_module_calls_functions_whose_last_digit_depends_on_the_machine(module):
    source = (Path(kernel.__path__[0]) / module).read_text()
    assert list(violations(ast.parse(source))) == []
