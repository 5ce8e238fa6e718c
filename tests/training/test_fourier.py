"""Fourier expansion, eq. (1)."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from trueangle_training.fourier import FourierSeries, RankDeficientError, design_matrix, fit_fourier

FACES_DEG = np.arange(23) * 360.0 / 23


def test_a_goes_with_the_sine_and_b_with_the_cosine() -> None:
    series = FourierSeries(constant_arcsec=5.0, sine_arcsec=(2.0, 0.0), cosine_arcsec=(0.0, 3.0))
    # At 90 deg sin θ = 1 and cos 2θ = -1; at 0 deg only the cosine stands.
    assert series.evaluate(np.array([0.0, 90.0])) == pytest.approx([8.0, 4.0], abs=1e-12)


def test_order_11_passes_through_23_values() -> None:
    error_arcsec = np.random.default_rng(1).normal(0.0, 50.0, 23)
    series = fit_fourier(FACES_DEG, error_arcsec, 11)
    # 1e-11 is a few hundred roundings of 50 arcsec (7e-15 each).
    assert series.evaluate(FACES_DEG) == pytest.approx(error_arcsec, abs=1e-11)


def test_coefficients_are_those_of_the_discrete_transform() -> None:
    error_arcsec = np.random.default_rng(2).normal(0.0, 50.0, 23)
    series = fit_fourier(FACES_DEG, error_arcsec, 11)
    transform = np.fft.rfft(error_arcsec) / 23
    assert series.constant_arcsec == pytest.approx(transform[0].real, abs=1e-11)
    assert series.cosine_arcsec == pytest.approx(2 * transform[1:].real, abs=1e-11)
    assert series.sine_arcsec == pytest.approx(-2 * transform[1:].imag, abs=1e-11)


def test_design_matrix_has_the_columns_of_appendix_a() -> None:
    matrix = design_matrix(np.array([30.0]), 2)
    expected = [1.0, 0.5, np.sqrt(3) / 2, np.sqrt(3) / 2, 0.5]
    assert matrix[0] == pytest.approx(expected, abs=1e-15)


def test_nearly_coinciding_angles_lose_no_digits_to_normal_equations() -> None:
    # A tenth of the circle and order 3: the condition number is about 4e6, so the normal equations' is 1e13,
    # which would leave three digits; the factorisation keeps nine.
    angle_deg = np.linspace(0.0, 36.0, 40)
    truth = FourierSeries(constant_arcsec=1.0, sine_arcsec=(2.0, -3.0, 4.0), cosine_arcsec=(-5.0, 6.0, 7.0))
    fitted = fit_fourier(angle_deg, truth.evaluate(angle_deg), 3)
    assert fitted.sine_arcsec == pytest.approx(truth.sine_arcsec, abs=1e-7)
    assert fitted.cosine_arcsec == pytest.approx(truth.cosine_arcsec, abs=1e-7)


def test_too_few_distinct_angles_are_refused_with_the_number_needed() -> None:
    angle_deg = np.tile(FACES_DEG[:6], 4)
    with pytest.raises(RankDeficientError, match=r"at least 7 distinct angles.*determine only 6.*order 2"):
        fit_fourier(angle_deg, np.zeros(24), 3)


def test_unequal_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"found shapes \(23,\) and \(22,\)"):
        fit_fourier(FACES_DEG, np.zeros(22), 2)


def test_a_coefficient_that_is_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError, match="finite coefficients"):
        FourierSeries(constant_arcsec=float("nan"), sine_arcsec=(), cosine_arcsec=())


coefficients = st.lists(st.floats(-100, 100), min_size=0, max_size=11)


@given(sine=coefficients, constant=st.floats(-100, 100))
def test_fitting_an_evaluated_series_gives_it_back(sine: list[float], constant: float) -> None:
    series = FourierSeries(
        constant_arcsec=constant, sine_arcsec=tuple(sine), cosine_arcsec=tuple(-value for value in sine)
    )
    fitted = fit_fourier(FACES_DEG, series.evaluate(FACES_DEG), series.order)
    assert fitted.constant_arcsec == pytest.approx(constant, abs=1e-10)
    assert fitted.sine_arcsec == pytest.approx(sine, abs=1e-10)


@given(angle_deg=st.floats(-720, 720))
def test_a_series_repeats_every_turn(angle_deg: float) -> None:
    series = FourierSeries(constant_arcsec=1.0, sine_arcsec=(70.0, 5.0), cosine_arcsec=(-30.0, 2.0))
    here, a_turn_on = series.evaluate(np.array([angle_deg, angle_deg + 360.0]))
    assert here == pytest.approx(a_turn_on, abs=1e-10)
