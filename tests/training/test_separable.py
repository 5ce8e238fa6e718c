"""Models whose temperature and angle separate, against their formula and against their graph."""

import dataclasses
import math

import numpy as np
import onnxruntime
import pytest

from trueangle_training.export import build_graph, check_agreement
from trueangle_training.methods.posterior import HarmonicPosterior, average, widened, with_links
from trueangle_training.methods.separable import CoefficientSpread, SeparableModel, TemperatureBasis
from trueangle_training.uncertainty import UncertaintyBudget, total_uncertainty_arcsec

BASIS = TemperatureBasis(
    centre_c=25.0,
    scale_c=10.0,
    powers=(0, 1, 3),
    tanh_slope=(1.3, -0.4),
    tanh_offset=(0.2, 0.7),
    bell_centre=(-1.0, 0.5),
    bell_length=(0.8, 1.5),
)


@pytest.fixture(scope="module")
def model() -> SeparableModel:
    rng = np.random.default_rng(1)
    of_model = CoefficientSpread(
        orders=(1, 2, 5), nodes_c=np.array([4.0, 15.0, 22.0, 46.0]), factor_arcsec=rng.normal(0.0, 0.1, (6, 4, 9))
    )
    unseen = CoefficientSpread(
        orders=(23,), nodes_c=np.array([25.0]), factor_arcsec=rng.normal(0.0, 0.3, (2, 1, 2))
    )
    return SeparableModel(
        orders=(1, 2, 5),
        basis=BASIS,
        weights_arcsec=rng.normal(0.0, 5.0, (BASIS.size, 6)),
        datum_deg=31.3,
        spreads=(of_model, unseen),
    )


def test_the_error_is_the_formula_written_out(model: SeparableModel) -> None:
    def coefficient(column: int, temperature_c: float) -> float:
        t = (temperature_c - 25.0) / 10.0
        functions = [1.0, t, t**3, math.tanh(1.3 * t + 0.2), math.tanh(-0.4 * t + 0.7)]
        functions += [math.exp(-((t + 1.0) ** 2) / (2 * 0.8**2)), math.exp(-((t - 0.5) ** 2) / (2 * 1.5**2))]
        return sum(f * w for f, w in zip(functions, model.weights_arcsec[:, column].tolist(), strict=True))

    for angle_deg, temperature_c in ((0.0, 10.0), (123.4, 33.0), (359.9, 55.0)):
        by_hand = 0.0
        for index, order in enumerate((1, 2, 5)):
            here, datum = math.radians(order * angle_deg), math.radians(order * 31.3)
            by_hand += coefficient(2 * index, temperature_c) * (math.cos(here) - math.cos(datum))
            by_hand += coefficient(2 * index + 1, temperature_c) * (math.sin(here) - math.sin(datum))
        served = model.error_arcsec(np.array([angle_deg]), np.array([temperature_c]))[0]
        assert served == pytest.approx(by_hand, abs=1e-11)


def test_error_and_uncertainty_are_exactly_zero_at_the_datum(model: SeparableModel) -> None:
    temperature_c = np.linspace(-20.0, 70.0, 91)
    at_datum = np.full(91, 31.3)
    assert (model.error_arcsec(at_datum, temperature_c) == 0.0).all()
    uncertainty = model.uncertainty_arcsec(at_datum, temperature_c)
    assert uncertainty is not None
    assert (uncertainty == 0.0).all()


def test_the_uncertainty_is_the_spread_of_models_drawn_from_it(model: SeparableModel) -> None:
    # 20000 draws leave half a percent of a standard deviation; 4 times that is allowed.
    spread = model.spreads[0]
    draws = np.random.default_rng(2).normal(size=(20000, spread.factor_arcsec.shape[2]))
    angle_deg, node = 200.0, 2
    coefficients = draws @ spread.factor_arcsec[:, node].T
    phase = np.radians(np.array([1, 2, 5]) * angle_deg) - 0.0
    datum = np.radians(np.array([1, 2, 5]) * 31.3)
    from_datum = np.empty(6)
    from_datum[0::2], from_datum[1::2] = np.cos(phase) - np.cos(datum), np.sin(phase) - np.sin(datum)
    drawn = float(np.std(coefficients @ from_datum))
    alone = dataclasses.replace(model, spreads=(spread,))
    served = alone.uncertainty_arcsec(np.array([angle_deg]), np.array([22.0]))
    assert served is not None
    assert served[0] == pytest.approx(drawn, rel=0.02)


def test_outside_its_nodes_the_uncertainty_stays_and_never_shrinks_to_nothing(model: SeparableModel) -> None:
    angle_deg = np.full(3, 200.0)
    served = model.uncertainty_arcsec(angle_deg, np.array([46.0, 60.0, 1000.0]))
    assert served is not None
    assert served == pytest.approx(np.full(3, served[0]), rel=1e-12)


@pytest.mark.parametrize(
    "budget",
    [UncertaintyBudget(), UncertaintyBudget(reference_arcsec=0.3), UncertaintyBudget(temperature_c=0.2)],
)
def test_the_graph_agrees_over_turns_and_temperatures(model: SeparableModel, budget: UncertaintyBudget) -> None:
    angle_deg = np.concatenate(
        [np.random.default_rng(3).uniform(-1000.0, 1000.0, 3000), [0.0, 31.3, 360.0, -1e-20]]
    )
    temperature_c = np.random.default_rng(4).uniform(-30.0, 80.0, angle_deg.size)
    for size in (0, 1, angle_deg.size):
        data = build_graph(model, budget).SerializeToString()
        # Coefficients of some tens of arcsec (t³ of some hundreds) in float64; a float32 anywhere leaves 1e-5.
        assert check_agreement(data, model, angle_deg[:size], temperature_c[:size], budget) < 1e-9


def test_a_graph_of_another_uncertainty_is_found_out(model: SeparableModel) -> None:
    data = build_graph(model, UncertaintyBudget(reference_arcsec=0.30001)).SerializeToString()
    angle_deg, temperature_c = np.linspace(0.0, 350.0, 50), np.full(50, 20.0)
    budget = UncertaintyBudget(reference_arcsec=0.3)
    assert check_agreement(data, model, angle_deg, temperature_c, budget) > 1e-6
    without = dataclasses.replace(model, spreads=())
    assert check_agreement(data, without, angle_deg, temperature_c, budget) == np.inf


def test_an_unknown_input_gives_no_uncertainty_that_looks_known(model: SeparableModel) -> None:
    session = onnxruntime.InferenceSession(
        build_graph(model).SerializeToString(), providers=["CPUExecutionProvider"]
    )
    feeds = {"angle_deg": np.array([np.nan, 100.0]), "temperature_c": np.array([20.0, np.nan])}
    for served in session.run(["correction_arcsec", "uncertainty_arcsec"], feeds):
        assert np.isnan(np.asarray(served)).all()


def test_sensor_and_reference_add_in_squares(model: SeparableModel) -> None:
    angle_deg, temperature_c = np.array([200.0]), np.array([27.0])
    own = model.uncertainty_arcsec(angle_deg, temperature_c)
    total = total_uncertainty_arcsec(
        model, UncertaintyBudget(reference_arcsec=0.4, temperature_c=0.1), angle_deg, temperature_c
    )
    slope = model.error_arcsec(angle_deg, temperature_c + 0.5) - model.error_arcsec(angle_deg, temperature_c - 0.5)
    assert own is not None
    assert total is not None
    assert total[0] ** 2 == pytest.approx(own[0] ** 2 + 0.4**2 + (0.1 * slope[0]) ** 2, rel=1e-12)


def _posterior(seed: int, basis: TemperatureBasis) -> HarmonicPosterior:
    rng = np.random.default_rng(seed)
    roots = rng.normal(size=(2, 6, 6))
    return HarmonicPosterior(
        basis=basis,
        weights_arcsec=rng.normal(size=(basis.size, 4)),
        nodes_c=np.array([10.0, 20.0, 30.0]),
        covariance=roots @ roots.swapaxes(1, 2),
    )


def test_an_average_is_the_mixture_of_its_parts() -> None:
    one = _posterior(1, BASIS)
    other = _posterior(
        2, TemperatureBasis(centre_c=25.0, scale_c=10.0, powers=(0, 2), tanh_slope=(3.0,), tanh_offset=(0.1,))
    )
    both = average([one, other], [0.25, 0.75])
    temperature_c = np.array([12.0, 29.0])
    parts = [post.basis.evaluate(temperature_c) @ post.weights_arcsec for post in (one, other)]
    served = both.basis.evaluate(temperature_c) @ both.weights_arcsec
    assert served == pytest.approx(0.25 * parts[0] + 0.75 * parts[1], abs=1e-12)
    # The law of total variance for two parts: the shares' product times the squared difference.
    apart = one.mean_at_nodes() - other.mean_at_nodes()
    expected = 0.25 * one.covariance + 0.75 * other.covariance
    expected += 0.25 * 0.75 * apart[:, :, None] * apart[:, None, :]
    assert both.covariance == pytest.approx(expected, abs=1e-12)


def test_doubt_keeps_the_mean_and_widens_by_the_whole_difference() -> None:
    one, other = _posterior(1, BASIS), _posterior(2, BASIS)
    doubted = widened(one, other, 0.3)
    assert doubted.weights_arcsec is one.weights_arcsec
    apart = one.mean_at_nodes() - other.mean_at_nodes()
    expected = 0.7 * one.covariance + 0.3 * (other.covariance + apart[:, :, None] * apart[:, None, :])
    assert doubted.covariance == pytest.approx(expected, abs=1e-12)


def test_links_carry_correlations_over_and_leave_each_harmonic_its_own() -> None:
    root = np.random.default_rng(5).normal(size=(12, 12))
    links = (root @ root.T).reshape(2, 6, 2, 6)
    own = links[np.arange(2), :, np.arange(2), :]
    same = with_links(own, links)
    assert same == pytest.approx(root @ root.T, abs=1e-9)
    wider = with_links(own * 4.0, links)
    # Twice the deviation everywhere: every covariance four times as large.
    assert wider == pytest.approx(4.0 * root @ root.T, abs=1e-8)
    assert (with_links(own, None)[:6, 6:] == 0.0).all()
