"""What the composition root makes of configuration, model and node; no socket is opened here."""

from pathlib import Path

import pytest

from trueangle.config import JointConfig, parse_config
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError
from trueangle.core.health import StatusBit
from trueangle.service import check_buses, encoder_differences, load_joints, node_plan, reasons
from trueangle.serving_settings import range_counts

DATA = Path(__file__).parents[1] / "data" / "models"
CONFIG = """\
schema_version: 1
buses: [{name: arm, interface: virtual, channel: c0}]
joints:
  - slot: 3
    name: wrist
    bus: arm
    node_id: 5
    model: good.onnx
    encoder: {counts_per_rev: 3276800, settings: {preset_value: 0}}
    temperature: {index: 0x7130, subindex: 1, degc_per_unit: 0.01, every_syncs: 7}
    sequence: {index: 0x2100, subindex: 0}
"""
NODE = EncoderSettings(
    serial_number=4711,
    operating_parameters=4,
    units_per_revolution=3_276_800,
    single_turn_resolution=65_536,
    preset_value=0,
)
"""The node that the model in tests/data was calibrated with."""


def joint(text: str = CONFIG) -> JointConfig:
    return parse_config(text, source="t.yaml").joints[0]


def test_the_plan_maps_position_and_sequence_on_every_sync_and_temperature_now_and_then() -> None:
    plan = node_plan(joint())
    assert [tpdo.cob_id for tpdo in plan.tpdos] == [0x185, 0x285]
    assert [tpdo.transmission_type for tpdo in plan.tpdos] == [1, 7]
    # index, subindex, bits as CiA 301 packs them into one UNSIGNED32
    assert [entry.entry for entry in plan.tpdos[0].mapping] == [0x60040020, 0x21000010]
    assert [entry.entry for entry in plan.tpdos[1].mapping] == [0x71300110]
    assert plan.tpdos[0].length == 6


def test_the_encoder_of_the_calibration_is_accepted() -> None:
    loaded = load_joints(parse_config(CONFIG, source="t.yaml"), base=DATA, source="t.yaml")[0]
    assert encoder_differences(loaded, NODE) == []


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({"serial_number": 1}, "serial_number expected 4711 found 1"),
        ({"preset_value": 8}, "preset_value expected 0 found 8"),
        ({"operating_parameters": 5}, "operating_parameters expected 4 found 5"),
        ({"units_per_revolution": 65_536}, "counts per revolution expected 3276800 found 65536"),
        # With scaling off the unit counts in its own resolution, whatever 0x6001 says.
        ({"operating_parameters": 0}, "counts per revolution expected 3276800 found 65536"),
        # 27.6 million and 2^32 (told as 0) are no whole number of turns: the position would wrap within one.
        ({"total_range_units": 27_600_000}, "total_range_units 27600000 is no whole number of turns"),
        ({"total_range_units": 0}, "total_range_units 0 is no whole number of turns"),
        ({"serial_number": None}, "serial_number expected 4711 found not readable"),
    ],
)
def test_an_encoder_that_differs_is_not_accepted(changed: dict[str, int | None], found: str) -> None:
    loaded = load_joints(parse_config(CONFIG, source="t.yaml"), base=DATA, source="t.yaml")[0]
    settings = EncoderSettings(**(NODE.known() | changed))
    assert found in encoder_differences(loaded, settings)


def test_model_and_configuration_must_mean_the_same_encoder() -> None:
    text = CONFIG.replace("counts_per_rev: 3276800", "counts_per_rev: 65536").replace(
        "preset_value: 0", "serial_number: 1"
    )
    with pytest.raises(ContractError) as caught:
        load_joints(parse_config(text, source="t.yaml"), base=DATA, source="t.yaml")
    assert "counts_per_rev 3276800 as at the calibration of good.onnx, found 65536" in str(caught.value)
    assert "serial_number 4711 as at the calibration of good.onnx, found 1" in str(caught.value)


def test_one_model_on_two_joints_is_a_fault() -> None:
    second = CONFIG[CONFIG.index("  - slot") :]
    second = second.replace("slot: 3", "slot: 4").replace("wrist", "elbow").replace("node_id: 5", "node_id: 6")
    with pytest.raises(
        ContractError, match=r"joint elbow: expected a model of its own, found good.onnx is also that"
    ):
        load_joints(parse_config(CONFIG + second, source="t.yaml"), base=DATA, source="t.yaml")


def test_faults_of_several_models_are_reported_together() -> None:
    second = CONFIG[CONFIG.index("  - slot") :]
    second = second.replace("slot: 3", "slot: 4").replace("wrist", "elbow").replace("node_id: 5", "node_id: 6")
    text = CONFIG.replace("good.onnx", "none.onnx") + second.replace("good.onnx", "nowhere.onnx")
    with pytest.raises(ContractError) as caught:
        load_joints(parse_config(text, source="t.yaml"), base=DATA, source="t.yaml")
    assert len(caught.value.faults) == 2


@pytest.mark.parametrize(
    ("bus", "found"),
    [
        ("interface: scketcand, channel: c0", "t.yaml, buses[0].interface: expected an interface of python-can: "),
        ("interface: socketcand, channel: c0", "buses[0].options: expected host (a text) and port (1 to 65535)"),
        ("interface: socketcand, channel: c0, options: {host: h, port: abc}", "found host 'h', port 'abc'"),
    ],
)
def test_a_bus_that_can_never_open_is_a_fault(bus: str, found: str) -> None:
    text = CONFIG.replace("interface: virtual, channel: c0", bus)
    with pytest.raises(ContractError) as caught:
        check_buses(parse_config(text, source="t.yaml"), source="t.yaml")
    assert found in str(caught.value)


def test_reasons_are_words() -> None:
    status = StatusBit.CONFIGURED | StatusBit.STALE | StatusBit.BUS_DOWN
    assert reasons(status) == "stale,bus_down"
    assert reasons(StatusBit.CONFIGURED | StatusBit.VALID) == "none"


@pytest.mark.parametrize(("told", "counts"), [(None, None), (0, 2**32), (13_107_200, 13_107_200)])
def test_the_total_range_is_what_the_node_told_and_0_of_it_is_all_of_32_bits(
    told: int | None, counts: int | None
) -> None:
    assert range_counts(EncoderSettings(total_range_units=told)) == counts
    assert range_counts(None) is None
