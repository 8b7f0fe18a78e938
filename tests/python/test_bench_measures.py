"""The numbers of `dermis bench` against hand-computed ones."""

import math

import numpy as np
import pytest

pytest.importorskip("dermis._core", reason="the Rust core is not built")

from dermis.bench import measures, reference


def test_relative_error_by_hand():
    truth = np.array([[[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]])
    image = truth + np.array([[[0.5, 0.0, 0.0], [0.1, 0.0, 0.0]]])
    # s = 1, so that weights are 1 / (R^2 + 0.01).
    expected = np.array([[0.25 / 1.01 / 3.0, 0.01 / 0.01 / 3.0]])
    np.testing.assert_allclose(measures.error_map(image, truth), expected)
    errors = measures.measure(image, truth, None)
    assert errors.plain == pytest.approx(expected.mean())
    # Of two pixels the worse one is dropped.
    assert errors.trimmed == pytest.approx(expected[0, 0])
    assert (errors.noise, errors.relmse) == (0.0, errors.plain)
    assert errors.mse == pytest.approx((0.25 + 0.01) / 6.0)


def test_trimming_drops_a_thousandth_rounded_up():
    errors = np.ones((50, 42))
    errors[3, 4], errors[7, 8], errors[9, 9], errors[1, 1] = 1e6, 1e5, 1e4, 2.0
    keep = measures.kept(errors)
    assert keep.size - keep.sum() == 3
    assert errors[keep].mean() == pytest.approx((2100 - 3 - 1 + 2) / (2100 - 3))


def test_exposure_does_not_matter():
    rng = np.random.default_rng(1)
    truth, image = rng.random((2, 8, 8, 3))
    bright = measures.measure(image * 64.0, truth * 64.0, np.full(truth.shape, 0.1) * 64.0**2)
    plain = measures.measure(image, truth, np.full(truth.shape, 0.1))
    for name in ("plain", "trimmed", "noise", "noise_trimmed"):
        assert getattr(bright, name) == pytest.approx(getattr(plain, name))


def test_black_reference_is_refused():
    with pytest.raises(measures.MeasureError, match="black"):
        measures.measure(np.ones((2, 2, 3)), np.zeros((2, 2, 3)), None)


def test_noise_of_the_reference_is_subtracted():
    rng = np.random.default_rng(2)
    shape = (100, 100, 3)
    truth = 1.0 + rng.random(shape)
    # A reference that is as noisy as the image: half of what is measured is its own.
    halves = truth + 0.02 * math.sqrt(2.0) * rng.standard_normal((2, *shape))
    image = truth + 0.02 * rng.standard_normal(shape)
    mean, variance = reference.of_halves(*halves)
    errors = measures.measure(image, mean, variance)
    exact = float(measures.error_map(image, truth).mean())
    assert errors.plain == pytest.approx(2.0 * exact, rel=0.05)
    assert errors.relmse == pytest.approx(exact, rel=0.05)
    assert errors.relmse_trimmed == pytest.approx(exact, rel=0.05)
    assert errors.relmse_trimmed < errors.relmse
    assert errors.squared == pytest.approx(2.0 * 0.02**2, rel=0.05)
    assert errors.mse == pytest.approx(0.02**2, rel=0.05)


def test_halves_by_hand():
    mean, variance = reference.of_halves(np.full((1, 1, 3), 3.0), np.full((1, 1, 3), 1.0))
    assert mean[0, 0, 0] == 2.0 and variance[0, 0, 0] == 1.0


def test_bias_by_hand_and_its_threshold():
    block = measures.BLOCK
    truth = np.ones((1, 4 * block, 3))
    by_block = np.array([[[1.0, 1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]])
    image = truth + np.repeat(by_block, block, axis=1)
    # Sum over root of sum of squares: 4 / 2, 0 / 2, nothing.
    assert measures.bias(image, truth, block=block) == [2.0, 0.0, 0.0]
    # What neighbours have in common is seen once, what is not measured not at all.
    mask = np.repeat([[True, True, False, False]], block, axis=1)
    assert measures.bias(image, truth, mask, block) == [pytest.approx(math.sqrt(2.0)), 0.0, 0.0]
    # Two-sided 1 % of a normal distribution, and a hundredth of it.
    assert measures.bias_threshold(1) == pytest.approx(2.5758, abs=1e-4)
    assert measures.bias_threshold(100) == pytest.approx(3.8906, abs=1e-4)


def test_numbers_by_hand():
    three = measures.number([1.0, 2.0, 3.0])
    assert (three.mean, three.error) == (2.0, pytest.approx(1.0 / math.sqrt(3.0)))
    assert measures.number([5.0]).error is None


def test_ratio_by_hand():
    # Means 4 x 2 over 1 x 4.
    ratio = measures.efficiency_ratio([0.5, 1.5], [4.0, 4.0], [4.0, 4.0], [2.0, 2.0])
    assert ratio.mean == pytest.approx(2.0)
    # Shares -0.5 and -1.5: standard deviation sqrt(1/2), over sqrt(2) seeds.
    assert ratio.error == pytest.approx(2.0 * 0.5)
    # What goes up and down with the baseline is no uncertainty of the ratio.
    paired = measures.efficiency_ratio([1.0, 3.0], [1.0, 1.0], [2.0, 6.0], [1.0, 1.0])
    assert (paired.mean, paired.error) == (pytest.approx(2.0), pytest.approx(0.0, abs=1e-12))
    assert measures.efficiency_ratio([-1.0], [1.0], [1.0], [1.0]) is None


def test_masked_errors_are_those_of_the_masked_pixels_alone():
    rng = np.random.default_rng(3)
    truth, image, variance = rng.random((3, 8, 8, 3))
    mask = np.zeros((8, 8), dtype=bool)
    mask[2:6, 3:7] = True
    part = (slice(2, 6), slice(3, 7))
    masked = measures.measure(image, truth, variance, mask)
    assert masked == measures.measure(image[part], truth[part], variance[part])
    assert masked != measures.measure(image, truth, variance)
    with pytest.raises(measures.MeasureError, match="no pixel is measured"):
        measures.measure(image, truth, variance, np.zeros((8, 8), dtype=bool))


def test_flip_grows_with_the_error():
    pytest.importorskip("flip_evaluator")
    rng = np.random.default_rng(4)
    truth = rng.random((32, 32, 3), dtype=np.float32)
    noise = rng.standard_normal(truth.shape, dtype=np.float32)
    little, much = (np.clip(truth + size * noise, 0.0, 1.0) for size in (0.02, 0.2))
    assert measures.flip(truth, truth) == 0.0
    assert 0.0 < measures.flip(little, truth) < measures.flip(much, truth) < 1.0
    # Black against white is as far as it goes.
    assert measures.flip(np.zeros_like(truth), np.ones_like(truth)) > 0.9
    half = np.zeros((32, 32), dtype=bool)
    half[:, 16:] = True
    changed = truth.copy()
    changed[:, :8] = 0.0
    assert measures.flip(changed, truth, half) < 0.01 < measures.flip(changed, truth)


def test_bands_are_those_of_student():
    stats = pytest.importorskip("scipy.stats")
    for freedom in range(1, 100):
        assert measures.student(freedom) == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-3)
    low, high = measures.number([1.0, 2.0, 3.0]).band
    # Mean 2, standard error 1 / sqrt(3), in the logarithm.
    factor = math.exp(stats.t.ppf(0.975, 2) / math.sqrt(3.0) / 2.0)
    assert (low, high) == (pytest.approx(2.0 / factor, rel=1e-3), pytest.approx(2.0 * factor, rel=1e-3))
    assert measures.number([1.0]).band is None and measures.number([-1.0, 0.5]).band is None


def test_slope_by_hand():
    # Halved error for twice the samples, and for four times.
    found = measures.slope([[1.0, 2.0, 4.0], [1.0, 4.0]], [[8.0, 4.0, 2.0], [2.0, 1.0]])
    assert found.mean == pytest.approx(-0.75) and found.error == pytest.approx(0.25)
    assert measures.slope([[4.0]], [[1.0]]) is None
    assert measures.slope([[1.0, 2.0]], [[1.0, -0.1]]) is None


def test_geometric_mean_by_hand():
    mean = measures.geometric_mean([measures.Number(2.0, 0.2), measures.Number(8.0, 0.8)])
    assert mean.mean == pytest.approx(4.0)
    assert mean.error == pytest.approx(4.0 * math.hypot(0.1, 0.1) / 2.0)
    assert measures.geometric_mean([]) is None
