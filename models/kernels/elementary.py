"""Branch-free elementary functions that LLVM vectorises, for float64 and, from the same source, complex128.

Polynomials through the Chebyshev points of their interval, relative error below 1e-15. Whatever depends on
the exponent bits looks at the real part only, so the imaginary part of a complex step passes through as a
derivative.
"""

from collections.abc import Callable
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic, overload

from bayesterra.models.kernels.compiler import FAST, Number, inlined

_DOUBLE, _INT32, _INT64 = ir.DoubleType(), ir.IntType(32), ir.IntType(64)
_BIAS = 1023
_WHOLE = 1.5 * 2.0**52 + _BIAS  # a sum with it has no digits behind the point
_SQRT_HALF_BITS = int(np.float64(0.5**0.5).view(np.int64))
_LOG2_E = 1.4426950408889634
_LN_2 = 0.6931471805599453
_EXP_LIMIT = 708.0
_OPTIONS: Any = {"fastmath": FAST, "error_model": "numpy", "forceinline": True}

_EXP = (
    1.0,
    1.0000000000000067,
    0.5000000000000006,
    0.16666666666554406,
    0.04166666666657314,
    0.008333333385667782,
    0.0013888888932488599,
    0.00019841170270440067,
    2.4801504346997686e-05,
    2.764018079620985e-06,
    2.7626357441247223e-07,
)
_LOG = (
    2.0000000000000004,
    0.6666666666655292,
    0.40000000061741614,
    0.2857141602110767,
    0.22223434547517906,
    0.18121934431215214,
    0.16837659970680488,
)
_SIN = (
    0.9999999999999999,
    -0.16666666666666072,
    0.008333333333282726,
    -0.00019841269824853736,
    2.7557316608034622e-06,
    -2.5051881879351066e-08,
    1.6048166167666442e-10,
    -7.374360691567403e-13,
)
_VERSINE = (
    0.5,
    -0.04166666666666634,
    0.0013888888888860694,
    -2.4801587292441663e-05,
    2.755731776674132e-07,
    -2.08766308298722e-09,
    1.1464688686901012e-11,
    -4.6276610380051693e-14,
)
_ARCSIN = (
    0.9999999999999999,
    0.16666666666676427,
    0.07499999997907882,
    0.044642858914474275,
    0.030381865584522647,
    0.022374287291571572,
    0.017314897522944798,
    0.014433415647987925,
    0.007375604220007111,
    0.03718381828511521,
    -0.12603009716318744,
    0.5016596628094211,
    -1.353015710351777,
    2.764660939213043,
    -4.015561213734368,
    4.001828596101466,
    -2.4409382579876335,
    0.7100464866097544,
)


@intrinsic
def _power_of_two(typingctx: Any, k: Any) -> Any:
    """2^k for a whole number k held as the float _WHOLE + k, whose last bits are those of the exponent."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        return builder.bitcast(builder.shl(builder.bitcast(args[0], _INT64), ir.Constant(_INT64, 52)), _DOUBLE)

    return types.float64(types.float64), build


@intrinsic
def _binary_exponent(typingctx: Any, x: Any) -> Any:
    """Whole number e, as a float, for which x 2^-e lies in [sqrt(1/2), sqrt(2))."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        exponent = builder.ashr(_above(builder, args[0]), ir.Constant(_INT64, 52))
        return builder.sitofp(builder.trunc(exponent, _INT32), _DOUBLE)  # AVX2 converts from 32 bits only

    return types.float64(types.float64), build


@intrinsic
def _inverse_power(typingctx: Any, x: Any) -> Any:
    """2^-e for the binary exponent e of x."""

    def build(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        exponent = builder.and_(_above(builder, args[0]), ir.Constant(_INT64, -1 << 52))
        return builder.bitcast(builder.sub(ir.Constant(_INT64, _BIAS << 52), exponent), _DOUBLE)

    return types.float64(types.float64), build


def _above(builder: Any, x: Any) -> Any:
    """Bits of x less those of sqrt(1/2)."""
    return builder.sub(builder.bitcast(x, _INT64), ir.Constant(_INT64, _SQRT_HALF_BITS))


power_of_two: Callable[[float], float] = cast(Any, _power_of_two)
binary_exponent: Callable[[float], float] = cast(Any, _binary_exponent)
inverse_power: Callable[[float], float] = cast(Any, _inverse_power)


def divide(a: Number, b: Number) -> Number:
    """Quotient a / b; for complex numbers to first order in the imaginary parts, as a complex step."""
    return a / b


def root(x: Number) -> Number:
    """Square root; for complex numbers to first order in the imaginary part."""
    y: Number = x**0.5
    return y


def hold(x: Number) -> Number:
    """x, with its real part held within +-708."""
    return x


def _hold_plain(x: Any) -> Any:
    x = x if x > -_EXP_LIMIT else -_EXP_LIMIT
    return x if x < _EXP_LIMIT else _EXP_LIMIT


def _hold_complex(x: Any) -> Any:
    return complex(min(max(x.real, -_EXP_LIMIT), _EXP_LIMIT), x.imag)


def _hold(x: Any) -> Any:
    return _hold_complex if x == types.complex128 else _hold_plain


def _divide_plain(a: Any, b: Any) -> Any:
    return a / b


def _divide_first_order(a: Any, b: Any) -> Any:
    quotient = a.real / b.real
    return complex(quotient, (a.imag - quotient * b.imag) / b.real)


def _root_plain(x: Any) -> Any:
    return np.sqrt(x)


def _root_first_order(x: Any) -> Any:
    value = np.sqrt(x.real)
    return complex(value, 0.5 * x.imag / value)


def _divide(a: Any, b: Any) -> Any:
    return _divide_first_order if types.complex128 in (a, b) else _divide_plain


def _root(x: Any) -> Any:
    return _root_first_order if x == types.complex128 else _root_plain


overload(divide, jit_options=_OPTIONS)(_divide)
overload(root, jit_options=_OPTIONS)(_root)
overload(hold, jit_options=_OPTIONS)(_hold)


@inlined
def exp(x: Number) -> Number:
    """e^x; arguments beyond +-708 are held there."""
    x, scale = _reduce(x)
    return (1.0 + _series(x)) * scale


@inlined
def exp_minus_1(x: Number) -> Number:
    """e^x - 1 without cancellation at small x; arguments beyond +-708 are held there."""
    x, scale = _reduce(x)
    return scale * _series(x) + (scale - 1.0)


@inlined
def _reduce(x: Number) -> tuple[Number, float]:
    """The rest x - k ln 2 and 2^k, where k is the whole number nearest to x / ln 2."""
    x = hold(x)
    shifted = x.real * _LOG2_E + _WHOLE
    return x - (shifted - _WHOLE) * _LN_2, power_of_two(shifted)


@inlined
def _series(x: Number) -> Number:
    """e^x - 1 for |x| <= ln(2)/2."""
    a, square = _EXP, x * x
    fourth = square * square
    low = _fours((a[1], a[2], a[3], a[4]), x, square)
    high = _fours((a[5], a[6], a[7], a[8]), x, square)
    return x * (low + fourth * (high + fourth * (a[9] + x * a[10])))


@inlined
def _fours(a: tuple[float, float, float, float], x: Number, square: Number) -> Number:
    """Cubic polynomial: its halves side by side, since what waits for one sum after the other is slow."""
    return (a[0] + x * a[1]) + square * (a[2] + x * a[3])


@inlined
def log(x: Number) -> Number:
    """Natural logarithm of a positive normal number."""
    k = binary_exponent(x.real)
    x = x * inverse_power(x.real)
    s = divide(x - 1.0, x + 1.0)
    t = s * s
    a, square = _LOG, t * t
    series = _fours((a[0], a[1], a[2], a[3]), t, square) + square * square * ((a[4] + t * a[5]) + square * a[6])
    return k * _LN_2 + s * series


@inlined
def sin(x: Number) -> Number:
    """Sine for |x| <= pi/2."""
    return x * _eights(_SIN, x * x)


@inlined
def versine(x: Number) -> Number:
    """1 - cos(x) for |x| <= pi/2, without cancellation."""
    t = x * x
    return t * _eights(_VERSINE, t)


@inlined
def _eights(a: tuple[float, ...], t: Number) -> Number:
    """Polynomial of eight coefficients."""
    square = t * t
    low, high = _fours((a[0], a[1], a[2], a[3]), t, square), _fours((a[4], a[5], a[6], a[7]), t, square)
    return low + square * square * high


@inlined
def angle_of_versine(x: Number) -> Number:
    """arccos(1 - x) for 0 <= x <= 1, accurate for small x."""
    t = 0.5 * x
    a, eighth = _ARCSIN, (t * t) * (t * t) * ((t * t) * (t * t))
    series = _eights(a[:8], t) + eighth * (_eights(a[8:16], t) + eighth * (a[16] + t * a[17]))
    return 2.0 * root(t) * series
