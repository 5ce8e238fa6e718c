"""The exported graph against the model it was made from."""

import dataclasses

import numpy as np
import onnx
import onnxruntime
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from tests.training.reference_joint import polygon_campaign

from trueangle_training.export import attach_metadata, build_graph, check_agreement
from trueangle_training.fourier import FourierSeries
from trueangle_training.methods import TrainingReadings
from trueangle_training.methods.fe_gabpnn_paper import (
    FeGabpnnModel,
    FeGabpnnOptions,
    Fitness,
    Scaling,
    train_fe_gabpnn,
)

Floats = NDArray[np.float64]

FIFTH_FACE_DEG = 5 * 360.0 / 23


@pytest.fixture(scope="module")
def model() -> FeGabpnnModel:
    campaign = polygon_campaign(1)
    readings = TrainingReadings(
        angle_deg=campaign.angle_deg,
        error_arcsec=campaign.error_arcsec,
        temperature_c=campaign.temperature_c,
        run=campaign.run,
    )
    return train_fe_gabpnn(readings, FeGabpnnOptions(fitness=Fitness.UNTRAINED)).model


@pytest.fixture(scope="module")
def session(model: FeGabpnnModel) -> onnxruntime.InferenceSession:
    return session_of(model)


def session_of(model: FeGabpnnModel) -> onnxruntime.InferenceSession:
    return onnxruntime.InferenceSession(build_graph(model).SerializeToString(), providers=["CPUExecutionProvider"])


def correction_arcsec(session: onnxruntime.InferenceSession, angle_deg: Floats, temperature_c: Floats) -> Floats:
    return np.asarray(
        session.run(["correction_arcsec"], {"angle_deg": angle_deg, "temperature_c": temperature_c})[0]
    )


def hard_angles_deg() -> Floats:
    rng = np.random.default_rng(20)
    seam = [
        0.0,
        -0.0,
        1e-300,
        -1e-300,
        -1e-20,
        -1e-14,
        1e-9,
        np.nextafter(360.0, 0.0),
        360.0,
        -360.0,
        720.0,
        359.999,
    ]
    return np.concatenate([rng.uniform(-1000.0, 1000.0, 5000), np.arange(23) * 360.0 / 23, np.array(seam)])


def test_onnx_runtime_agrees_with_the_model_over_turns_seam_and_temperatures(model: FeGabpnnModel) -> None:
    angle_deg = hard_angles_deg()
    temperature_c = np.random.default_rng(21).uniform(-40.0, 85.0, angle_deg.size)
    # Required is 1e-6; sums of a few hundred arcsec in float64 leave 1e-12, a float32 anywhere 2e-5.
    assert check_agreement(build_graph(model).SerializeToString(), model, angle_deg, temperature_c) < 1e-10


def test_agreement_holds_for_another_datum_and_another_size(model: FeGabpnnModel) -> None:
    other = dataclasses.replace(model, datum_deg=FIFTH_FACE_DEG)
    angle_deg = hard_angles_deg()
    for size in (0, 1, 6, angle_deg.size):
        temperature_c = np.full(size, 31.0)
        assert (
            check_agreement(build_graph(other).SerializeToString(), other, angle_deg[:size], temperature_c) < 1e-10
        )


def test_a_graph_of_another_model_is_found_out(model: FeGabpnnModel) -> None:
    span = model.target_scaling.span * (1 + 1e-6)
    other = dataclasses.replace(model, target_scaling=dataclasses.replace(model.target_scaling, span=span))
    angle_deg, temperature_c = np.linspace(0.0, 360.0, 100), np.full(100, 40.0)
    assert check_agreement(build_graph(other).SerializeToString(), model, angle_deg, temperature_c) > 1e-6


def test_correction_is_exactly_zero_at_the_datum(model: FeGabpnnModel) -> None:
    temperature_c = np.linspace(-40.0, 85.0, 251)
    for datum_deg in (0.0, FIFTH_FACE_DEG):
        session = session_of(dataclasses.replace(model, datum_deg=datum_deg))
        assert (correction_arcsec(session, np.full(251, datum_deg), temperature_c) == 0.0).all()
    at_zero = session_of(model)
    for turn_deg in (-720.0, -360.0, 360.0, 720.0):
        assert (correction_arcsec(at_zero, np.full(251, turn_deg), temperature_c) == 0.0).all()


def test_correction_has_the_opposite_sign_of_the_error(model: FeGabpnnModel) -> None:
    # cos(θ) alone: the error at 180 deg, counted from 0, is -20 arcsec; the correction must add 20.
    only_base = dataclasses.replace(
        model,
        base=FourierSeries(constant_arcsec=3.0, sine_arcsec=(0.0,), cosine_arcsec=(10.0,)),
        parameters=(0.0,) * len(model.parameters),
    )
    served = correction_arcsec(session_of(only_base), np.array([180.0, 90.0]), np.array([20.0, 20.0]))
    assert served == pytest.approx([20.0, 10.0], abs=1e-12)


@settings(max_examples=200, deadline=None)
@given(angle_deg=st.floats(-1000.0, 1000.0), temperature_c=st.floats(-40.0, 85.0))
def test_a_full_turn_more_changes_nothing(
    session: onnxruntime.InferenceSession, angle_deg: float, temperature_c: float
) -> None:
    # The paper's network knows no turn: its error jumps at the seam, where adding 360 may round across it.
    from_seam_deg = abs(angle_deg / 360.0 - round(angle_deg / 360.0)) * 360.0
    if 0.0 < from_seam_deg < 1e-12:
        return
    turns = angle_deg + np.array([0.0, 360.0, -360.0, 720.0])
    served = correction_arcsec(session, turns, np.full(4, temperature_c))
    assert np.ptp(served) < 1e-9


def test_inputs_and_output_are_those_of_the_contract(session: onnxruntime.InferenceSession) -> None:
    described = [(put.name, put.type, put.shape) for put in [*session.get_inputs(), *session.get_outputs()]]
    assert described == [
        ("angle_deg", "tensor(double)", ["n"]),
        ("temperature_c", "tensor(double)", ["n"]),
        ("correction_arcsec", "tensor(double)", ["n"]),
    ]


def test_no_readings_give_an_empty_correction(session: onnxruntime.InferenceSession) -> None:
    served = correction_arcsec(session, np.empty(0), np.empty(0))
    assert served.shape == (0,)
    assert served.dtype == np.float64


def test_unknown_inputs_do_not_look_like_a_correction(session: onnxruntime.InferenceSession) -> None:
    served = correction_arcsec(session, np.array([np.nan, 100.0]), np.array([20.0, np.nan]))
    assert np.isnan(served).all()


def test_nothing_in_the_graph_is_single_precision(model: FeGabpnnModel) -> None:
    graph = build_graph(model).graph
    kinds = {constant.data_type for constant in graph.initializer}
    assert kinds == {onnx.TensorProto.DOUBLE, onnx.TensorProto.INT64, onnx.TensorProto.BOOL}
    assert not [node.op_type for node in graph.node if node.op_type in ("Mul", "Cast")]


def test_the_same_model_gives_the_same_bytes(model: FeGabpnnModel) -> None:
    assert build_graph(model).SerializeToString() == build_graph(model).SerializeToString()


def test_a_base_without_harmonics_can_be_exported() -> None:
    flat = FeGabpnnModel(
        base=FourierSeries(constant_arcsec=1.0, sine_arcsec=(), cosine_arcsec=()),
        parameters=(0.5, -0.3, 0.2, 2.0, 0.1),
        angle_scaling=Scaling(minimum=0.0, span=300.0),
        temperature_scaling=Scaling(minimum=10.0, span=30.0),
        target_scaling=Scaling(minimum=-8.0, span=16.0),
        datum_deg=0.0,
    )
    angle_deg, temperature_c = np.linspace(-400.0, 400.0, 50), np.linspace(10.0, 40.0, 50)
    assert check_agreement(build_graph(flat).SerializeToString(), flat, angle_deg, temperature_c) < 1e-12


def test_metadata_are_set_and_replaced_and_leave_the_graph_alone(model: FeGabpnnModel) -> None:
    proto = build_graph(model)
    before = proto.graph.SerializeToString()
    attach_metadata(proto, "trueangle", '{"schema": 0}')
    attach_metadata(proto, "trueangle", '{"schema": 1}')
    attach_metadata(proto, "other", "µm")
    reread = onnxruntime.InferenceSession(proto.SerializeToString(), providers=["CPUExecutionProvider"])
    assert reread.get_modelmeta().custom_metadata_map == {"trueangle": '{"schema": 1}', "other": "µm"}
    assert proto.graph.SerializeToString() == before


def test_an_answer_that_is_not_a_number_never_counts_as_agreement(model: FeGabpnnModel) -> None:
    broken = dataclasses.replace(model, parameters=(float("nan"),) * len(model.parameters))
    angle_deg, temperature_c = np.array([100.0]), np.array([20.0])
    assert check_agreement(build_graph(broken).SerializeToString(), model, angle_deg, temperature_c) == np.inf
