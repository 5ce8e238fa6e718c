"""How large exported graphs are, and what they give where separable models are hard: edges, turns, nodes, NaN."""

import dataclasses

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

from trueangle_training.export import build_graph, check_agreement
from trueangle_training.methods import FittedModel
from trueangle_training.methods.poly2d import Poly2dModel
from trueangle_training.methods.separable import CoefficientSpread, SeparableModel, TemperatureBasis
from trueangle_training.uncertainty import UncertaintyBudget, total_uncertainty_arcsec

Floats = NDArray[np.float64]

BUDGET = UncertaintyBudget(reference_arcsec=0.125, temperature_c=0.25)
NODES_C = np.array([4.0, 10.0, 12.5, 15.0, 22.0, 46.0])
FIFTH_FACE_DEG = 5 * 360.0 / 23
BASES = {
    "tanh": TemperatureBasis(centre_c=25.0, scale_c=10.0, tanh_slope=(1.3, -0.4), tanh_offset=(0.2, 0.7)),
    "bells": TemperatureBasis(centre_c=25.0, scale_c=10.0, bell_centre=(-1.0, 0.5), bell_length=(0.8, 1.5)),
    "line and bells": TemperatureBasis(
        centre_c=25.0, scale_c=10.0, powers=(0, 1), bell_centre=(-1.0, 0.5), bell_length=(0.8, 1.5)
    ),
    "powers": TemperatureBasis(centre_c=25.0, scale_c=15.0, powers=(0, 1, 2, 3, 4, 5)),
    "constant": TemperatureBasis(centre_c=25.0, scale_c=1.0),
    "all": TemperatureBasis(
        centre_c=25.0,
        scale_c=10.0,
        powers=(0, 1),
        tanh_slope=(1.3, -0.4),
        tanh_offset=(0.2, 0.7),
        bell_centre=(-1.0,),
        bell_length=(0.8,),
    ),
}
MOST_NODES = {"tanh": 29, "bells": 31, "line and bells": 33, "powers": 29, "constant": 28, "all": 35}
MOST_NODES_WITHOUT_UNCERTAINTY = {
    "tanh": 13,
    "bells": 15,
    "line and bells": 17,
    "powers": 13,
    "constant": 12,
    "all": 19,
}


def model_of(basis: TemperatureBasis, *, datum_deg: float = 0.0) -> SeparableModel:
    """Two spreads over different nodes and orders, and a steady one of orders that nothing else has."""
    rng = np.random.default_rng(1)
    return SeparableModel(
        orders=(1, 2, 5),
        basis=basis,
        weights_arcsec=rng.normal(0.0, 5.0, (basis.size, 6)),
        datum_deg=datum_deg,
        spreads=(
            CoefficientSpread(orders=(1, 2, 5), nodes_c=NODES_C, factor_arcsec=rng.normal(0.0, 0.1, (6, 6, 40))),
            CoefficientSpread(
                orders=(2, 7), nodes_c=np.array([11.0, 30.0]), factor_arcsec=rng.normal(0.0, 0.1, (4, 2, 3))
            ),
            CoefficientSpread(
                orders=(1, 23, 24), nodes_c=np.array([25.0]), factor_arcsec=rng.normal(0.0, 0.3, (6, 1, 2))
            ),
        ),
    )


def grid(datum_deg: float) -> tuple[Floats, Floats]:
    """All pairs of angles at seam, datum and turns of it with temperatures on, beside and far from the nodes."""
    # x + 360 is 360 down to -2^-45 and the largest number below 360 beyond.
    round_to_turn = [-(2.0**-45), np.nextafter(-(2.0**-45), -1.0), 2.0**-45, -360.0 - 2.0**-44]
    seam = [
        *round_to_turn,
        0.0,
        -0.0,
        1e-300,
        -1e-300,
        1e-20,
        -1e-20,
        -1e-14,
        1e-9,
        np.nextafter(360.0, 0.0),
        360.0,
        -720.0,
    ]
    turns = datum_deg + 360.0 * np.array([-1000.0, -2.0, -1.0, 0.0, 1.0, 3.0])
    beside = [np.nextafter(turns, 1e9), np.nextafter(turns, -1e9)]
    angles = np.concatenate([seam, turns, *beside, np.linspace(-400.0, 800.0, 241)])
    near = [np.nextafter(NODES_C, 100.0), np.nextafter(NODES_C, -100.0)]
    temperatures = np.concatenate([NODES_C, *near, [-273.15, -40.0, 85.0, 1000.0], np.linspace(0.0, 50.0, 41)])
    angle_deg, temperature_c = np.meshgrid(angles, temperatures)
    return angle_deg.ravel(), temperature_c.ravel()


@pytest.mark.parametrize("datum_deg", [0.0, FIFTH_FACE_DEG])
@pytest.mark.parametrize("basis", BASES)
def test_graph_and_model_agree_at_every_edge(basis: str, datum_deg: float) -> None:
    model = model_of(BASES[basis], datum_deg=datum_deg)
    data = build_graph(model, BUDGET).SerializeToString()
    angle_deg, temperature_c = grid(datum_deg)
    # Of some hundreds of arcsec and of 1e5 at most: t^5 is that at 100 degC, and 1e9 at 1000.
    inside = np.abs(temperature_c) < (100.0 if basis == "powers" else 2000.0)
    assert check_agreement(data, model, angle_deg[inside], temperature_c[inside], BUDGET) < 1e-8
    without = dataclasses.replace(model, spreads=())
    data = build_graph(without).SerializeToString()
    assert check_agreement(data, without, angle_deg[inside], temperature_c[inside]) < 1e-8


def test_a_single_reading_gets_what_it_gets_among_others() -> None:
    model = model_of(BASES["all"])
    session = session_of(model)
    angle_deg, temperature_c = (axis[::97] for axis in grid(0.0))
    together = run(session, angle_deg, temperature_c)
    for index in range(angle_deg.size):
        alone = run(session, angle_deg[index : index + 1], temperature_c[index : index + 1])
        for one, every in zip(alone, together, strict=True):
            # Sums of another order of terms: some units in the last place of a few arcsec.
            assert one[0] == pytest.approx(every[index], abs=1e-11)


@pytest.mark.parametrize("basis", BASES)
def test_what_is_no_number_is_told_and_spoils_no_other_reading(basis: str) -> None:
    model = model_of(BASES[basis])
    session = session_of(model)
    angle_deg = np.array([100.0, np.nan, np.inf, 100.0, 100.0, 100.0, 200.0])
    temperature_c = np.array([20.0, 20.0, 20.0, np.nan, np.inf, -np.inf, 30.0])
    good = np.array([0, 6])
    served = run(session, angle_deg, temperature_c)
    expected = (
        -model.error_arcsec(angle_deg[good], temperature_c[good]),
        total_uncertainty_arcsec(model, BUDGET, angle_deg[good], temperature_c[good]),
    )
    for one, wanted in zip(served, expected, strict=True):
        assert one[good] == pytest.approx(wanted, abs=1e-10)
        assert np.isnan(one[1:6]).all()


def test_correction_and_uncertainty_vanish_at_the_datum_and_only_there() -> None:
    for datum_deg in (0.0, FIFTH_FACE_DEG):
        session = session_of(model_of(BASES["all"], datum_deg=datum_deg))
        beside = [np.nextafter(datum_deg, 400.0), datum_deg + 1e-9]
        for temperature_c in (-40.0, 20.0, 85.0):
            correction, uncertainty = run(session, np.array([datum_deg, *beside]), np.full(3, temperature_c))
            assert correction[0] == uncertainty[0] == 0.0
            assert (uncertainty[1:] >= 0.125).all()


@pytest.mark.parametrize("basis", BASES)
def test_no_graph_has_more_nodes_than_it_needs(basis: str) -> None:
    model = model_of(BASES[basis])
    # A pass costs about half a microsecond a node, whatever the node does.
    assert len(build_graph(model, BUDGET).graph.node) <= MOST_NODES[basis]
    without = dataclasses.replace(model, spreads=())
    assert len(build_graph(without).graph.node) <= MOST_NODES_WITHOUT_UNCERTAINTY[basis]


def test_the_polynomial_of_the_paper_needs_16_nodes() -> None:
    coefficients = np.random.default_rng(3).normal(size=(6, 6))
    model = Poly2dModel(coefficients_arcsec=coefficients, centre_c=25.0, scale_c=15.0, datum_deg=31.3)
    kept = coefficients.copy()
    proto = build_graph(model)
    assert len(proto.graph.node) <= 16
    angle_deg, temperature_c = grid(31.3)
    inside = temperature_c < 100.0
    data = proto.SerializeToString()
    assert check_agreement(data, model, angle_deg[inside], temperature_c[inside]) < 1e-8
    # Export reads a model and leaves it as it is.
    assert (model.coefficients_arcsec == kept).all()


def session_of(model: FittedModel) -> onnxruntime.InferenceSession:
    data = build_graph(model, BUDGET).SerializeToString()
    return onnxruntime.InferenceSession(data, providers=["CPUExecutionProvider"])


def run(session: onnxruntime.InferenceSession, angle_deg: Floats, temperature_c: Floats) -> tuple[Floats, Floats]:
    feeds = {"angle_deg": angle_deg, "temperature_c": temperature_c}
    correction, uncertainty = session.run(["correction_arcsec", "uncertainty_arcsec"], feeds)
    return np.asarray(correction), np.asarray(uncertainty)
