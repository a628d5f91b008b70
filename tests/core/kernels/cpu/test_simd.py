# SPDX-License-Identifier: GPL-3.0-or-later
"""8-wide vector type against numpy."""

import numpy as np
import pytest
from irgspp.core.kernels.cpu import simd
from irgspp.core.kernels.cpu.jit import kernel
from irgspp.core.kernels.cpu.reductions import product, total, totals
from irgspp.core.kernels.cpu.simd import (
    bits,
    first_bit,
    floor,
    load,
    load_uint16,
    maximum,
    minimum,
    ramp,
    select,
    splat,
    sqrt,
    store,
    store_uint16,
)
from irgspp.core.kernels.cpu.simd_math import bounded_exp, exp, log2


@kernel
def arithmetic(a, b, s, out):
    x, y = load(a, 0), load(b, 0)
    store(out, 0, x + y)
    store(out, 8, x - y)
    store(out, 16, x * y)
    store(out, 24, x / y)
    store(out, 32, x * s + s)
    store(out, 40, s - x)
    store(out, 48, s / y)
    store(out, 56, sqrt(maximum(x, splat(s))))
    store(out, 64, floor(x))
    store(out, 72, minimum(x, y))
    store(out, 80, maximum(x, y))
    store(out, 88, ramp())
    store(out, 96, splat(s))


@kernel
def masks(a, b, s, out, codes):
    x, y = load(a, 0), load(b, 0)
    codes[0], codes[1], codes[2], codes[3] = bits(x < y), bits(x <= y), bits(x > y), bits(x >= y)
    codes[4], codes[5] = bits((x < y) & (x > s)), bits((x < y) | (x > s))
    codes[6] = bits(x > s)
    store(out, 0, select(x < y, x, splat(s)))


@kernel
def exponential(values, out):
    for i in range(0, len(values), 8):
        store(out, i, exp(load(values, i)))


@kernel
def bounded_exponential(values, out):
    for i in range(0, len(values), 8):
        store(out, i, bounded_exp(load(values, i)))


@kernel
def logarithm(values, out):
    for i in range(0, len(values), 8):
        store(out, i, log2(load(values, i)))


@kernel
def sums_of_eight(v, out):
    store(out, 0, totals(load(v, 0), load(v, 8), load(v, 16), load(v, 24), load(v, 32), load(v, 40), load(v, 48), load(v, 56)))


@kernel
def sums(values, out):
    for i in range(len(out)):
        out[i] = total(load(values, i))


@kernel
def products(values, out):
    for i in range(len(out)):
        out[i] = product(load(values, i))


@kernel
def first_below(values, limit):
    mask = bits(load(values, 0) < limit)
    return first_bit(mask) if mask != 0 else -1


@kernel
def shifted(values, at, out):
    store(out, at, load(values, at))


@kernel
def counted(values, whole, out):
    store_uint16(whole, 3, load(values, 0))
    store(out, 0, load_uint16(whole, 3))


@pytest.fixture
def pair():
    rng = np.random.default_rng(0)
    a, b = rng.normal(0, 3, (2, 8)).astype(np.float32)
    b[3] = a[3]
    return a, b


def test_arithmetic_matches_numpy(pair):
    a, b = pair
    s, out = np.float32(0.7), np.empty(104, np.float32)
    arithmetic(a, b, s, out)
    parts = a + b, a - b, a * b, a / b, a * s + s, s - a, s / b, np.sqrt(np.maximum(a, s)), np.floor(a), np.minimum(a, b), np.maximum(a, b)
    expected = np.concatenate([*parts, np.arange(8), np.full(8, s)])
    assert np.allclose(out, expected, rtol=3e-7, atol=1e-7)


def test_masks_pack_lane_zero_into_bit_zero(pair):
    a, b = pair
    s, out, codes = np.float32(0.5), np.empty(8, np.float32), np.empty(7, np.int64)
    masks(a, b, s, out, codes)
    expected = a < b, a <= b, a > b, a >= b, (a < b) & (a > s), (a < b) | (a > s), a > s
    assert codes.tolist() == [int((m * 2 ** np.arange(8)).sum()) for m in expected]
    assert np.array_equal(out, np.where(a < b, a, s))


def test_comparisons_with_nan_are_false():
    nan, codes, out = np.full(8, np.nan, np.float32), np.empty(7, np.int64), np.empty(8, np.float32)
    masks(nan, np.ones(8, np.float32), np.float32(0), out, codes)
    assert not codes.any()
    assert (out == 0).all()


def test_exp_over_its_whole_range():
    x = np.linspace(-87, 88, 400_000, dtype=np.float32)
    x = np.concatenate([x, np.linspace(-1e-3, 1e-3, 4000, dtype=np.float32), np.zeros(8, np.float32)])
    out = np.empty_like(x)
    exponential(x, out)
    exact = np.exp(x.astype(np.float64))
    assert np.abs(out / exact - 1).max() < 3e-7
    assert out[-1] == 1


def test_exp_is_clamped_not_overflowing():
    x = np.array([-1e30, -1000, -88, 89, 1000, 1e30, -np.inf, np.inf], np.float32)
    out = np.empty_like(x)
    exponential(x, out)
    low, high = np.exp(-87.0), np.exp(88.0)
    assert np.allclose(out, [low, low, low, high, high, high, low, high], rtol=1e-6)


def test_bounded_exp_over_its_range():
    x = np.linspace(-8, 8, 400_000, dtype=np.float32)
    out = np.empty_like(x)
    bounded_exponential(x, out)
    assert np.abs(out / np.exp(x.astype(np.float64)) - 1).max() < 1e-6


def test_log2_of_positive_values():
    x = np.concatenate([np.exp2(np.linspace(-126, 127.9, 400_000)), np.linspace(0.5, 2, 8000)]).astype(np.float32)
    out, exact = np.empty_like(x), np.log2(x.astype(np.float64))
    logarithm(x, out)
    assert (np.abs(out - exact) <= 2e-7 * np.abs(exact) + 6e-8).all()


def test_totals_of_eight_vectors():
    values, out = np.random.default_rng(2).normal(size=64).astype(np.float32), np.empty(8, np.float32)
    sums_of_eight(values, out)
    assert np.allclose(out, values.reshape(8, 8).sum(1), atol=1e-5)


def test_total_sums_any_eight_neighbours():
    values = np.random.default_rng(1).normal(size=40).astype(np.float32)
    out = np.empty(33, np.float32)
    sums(values, out)
    assert np.allclose(out, np.convolve(values, np.ones(8), "valid"), atol=1e-5)


def test_product_multiplies_any_eight_neighbours():
    values = np.random.default_rng(2).uniform(0.5, 1.5, 40).astype(np.float32)
    out = np.empty(33, np.float32)
    products(values, out)
    assert np.allclose(out, [values[i : i + 8].prod() for i in range(33)], rtol=1e-6)


def test_first_bit_is_the_lowest_lane():
    values = np.arange(8, 0, -1).astype(np.float32)
    assert [first_below(values, np.float32(limit)) for limit in (9, 8, 4.5, 1.5, 1)] == [0, 1, 4, 7, -1]


def test_load_and_store_need_no_alignment_and_touch_nothing_else():
    values = np.arange(32, dtype=np.float32)
    for at in range(32 - simd.WIDTH + 1):
        out = np.full(32, -1, np.float32)
        shifted(values, at, out)
        assert np.array_equal(out, np.where((values >= at) & (values < at + 8), values, -1))


def test_whole_numbers_are_kept_rounded_down():
    values = np.float32([0.0, 0.9, 1.0, 255.5, 256.0, 32768.3, 40000.9, 65535.0])
    whole, out = np.full(12, 7, np.uint16), np.empty(8, np.float32)
    counted(values, whole, out)
    assert whole.tolist() == [7, 7, 7, 0, 0, 1, 255, 256, 32768, 40000, 65535, 7]
    assert np.array_equal(out, whole[3:11])
