"""What the configuration makes of nodes: who sends what, with which COB-ID, made to send by what."""

import pytest

from trueangle.config import DaemonConfig, parse_config
from trueangle.contract.errors import ContractError
from trueangle.core.frames import Quantity, frame_layouts
from trueangle.process_data import node_plan, node_plans, plan_faults

HEAD = "schema_version: 1\nbuses: [{name: arm, interface: virtual, channel: c0}]\njoints:\n"


def joint(slot: int, temperature: str = "", more: str = "") -> str:
    return (
        f"  - {{slot: {slot}, name: j{slot}, bus: arm, node_id: {slot}, model: m{slot}.onnx, {more}\n"
        f"     encoder: {{counts_per_rev: 3276800}},\n"
        f"     temperature: {{index: 0x7130, subindex: {slot}, degc_per_unit: 0.01, {temperature}}}}}\n"
    )


def parsed(*joints: str) -> DaemonConfig:
    return parse_config(HEAD + "".join(joints), source="t.yaml")


def test_timer_driven_encoder_has_its_event_timer_and_needs_no_sync() -> None:
    plan = node_plan(parsed(joint(1, more="tpdo: {trigger: timer, period_ms: 5}, ")).joints[0])
    position, temperature = plan.tpdos
    assert (position.transmission_type, position.event_timer_ms, position.synchronous) == (255, 5, False)
    assert (temperature.transmission_type, temperature.event_timer_ms) == (20, None)


def test_temperatures_of_several_joints_share_the_frames_of_one_sensor_node() -> None:
    """Four INTEGER16 fit into a frame; the fifth needs another."""
    config = parsed(*(joint(slot, "node_id: 40, tpdo: {trigger: event}") for slot in range(1, 6)))
    plans = node_plans(config.joints, "arm")
    assert [plan.node_id for plan in plans] == [1, 2, 3, 4, 5, 40]
    assert [len(plan.tpdos) for plan in plans] == [1, 1, 1, 1, 1, 2]
    sensor = plans[-1]
    assert sensor.slot is None
    assert [(tpdo.cob_id, tpdo.length, tpdo.transmission_type) for tpdo in sensor.tpdos] == [
        (0x180 + 40, 8, 255),
        (0x280 + 40, 2, 255),
    ]
    layouts = frame_layouts(sensor)
    assert layouts[0x180 + 40].slots == (1, 2, 3, 4)
    assert layouts[0x180 + 40].slot is None
    # A sensor that tells only of changes is asked once, else silence could mean "never told".
    assert [(p.value.slot, p.period_ms) for p in sensor.polls] == [(slot, None) for slot in range(1, 6)]


def test_sensor_on_the_encoder_of_another_joint_has_a_frame_of_its_own_there() -> None:
    config = parsed(joint(1), joint(2, "node_id: 1"))
    first, second = node_plans(config.joints, "arm")
    assert [frame_layouts(first)[tpdo.cob_id].slot for tpdo in first.tpdos] == [1, 1, None]
    assert frame_layouts(first)[0x381].slots == (2,)
    assert [tpdo.number for tpdo in second.tpdos] == [1]
    # What the pipeline knows of joint 1 alone has the same COB-IDs as what its node is told to send.
    assert node_plan(config.joints[0]).tpdos == first.tpdos[:2]


def test_polled_temperature_and_status_are_not_mapped() -> None:
    text = "poll_ms: 500, status: {index: 0x6150, subindex: 1, poll_ms: 1000}"
    plan = node_plan(parsed(joint(1, text)).joints[0])
    assert [tpdo.number for tpdo in plan.tpdos] == [1]
    assert [(p.value.quantity, p.period_ms) for p in plan.polls] == [
        (Quantity.TEMPERATURE_STATUS, 1000),
        (Quantity.TEMPERATURE, 500),
    ]


def test_status_is_mapped_beside_the_temperature() -> None:
    plan = node_plan(parsed(joint(1, "status: {index: 0x6150, subindex: 1}")).joints[0])
    assert [o.quantity for o in plan.tpdos[1].mapping] == [Quantity.TEMPERATURE, Quantity.TEMPERATURE_STATUS]
    assert plan.tpdos[1].length == 3


def test_decimal_digits_of_cia_404_are_expected_as_the_scale_says() -> None:
    (wanted,) = node_plan(parsed(joint(1)).joints[0]).expected
    assert (wanted.index, wanted.subindex, wanted.value) == (0x6132, 1, 2)
    assert node_plan(parsed(joint(1, "check_digits: false")).joints[0]).expected == ()


def test_more_temperatures_than_a_node_can_send_are_a_fault_at_the_start() -> None:
    config = parsed(*(joint(slot, "node_id: 40") for slot in range(1, 18)))
    (fault,) = plan_faults(config, source="t.yaml")
    assert "node 40" in str(fault)
    assert "5 frames" in str(fault)
    with pytest.raises(ContractError):
        node_plans(config.joints, "arm")


def test_one_node_id_on_two_buses_is_two_nodes() -> None:
    text = HEAD.replace("}]", "}, {name: leg, interface: virtual, channel: c1}]") + joint(1)
    text += joint(2).replace("bus: arm", "bus: leg").replace("node_id: 2", "node_id: 1")
    config = parse_config(text, source="t.yaml")
    assert [plan.slot for plan in node_plans(config.joints, "arm")] == [1]
    assert [plan.slot for plan in node_plans(config.joints, "leg")] == [2]


def test_temperature_node_on_another_bus_is_planned_there_and_nowhere_else() -> None:
    text = HEAD.replace("}]", "}, {name: leg, interface: virtual, channel: c1}]")
    text += joint(1, "bus: leg, node_id: 1") + joint(2, "bus: leg, node_id: 1")
    config = parse_config(text, source="t.yaml")
    assert [(p.slot, p.node_id, len(p.tpdos)) for p in node_plans(config.joints, "arm")] == [(1, 1, 1), (2, 2, 1)]
    (sensor,) = node_plans(config.joints, "leg")
    assert (sensor.slot, sensor.node_id) == (None, 1)
    assert frame_layouts(sensor)[0x181].slots == (1, 2)
    # What the pipeline knows of joint 1 alone: node 1 of its own bus is its encoder, and measures nothing.
    assert [tpdo.number for tpdo in node_plan(config.joints[0]).tpdos] == [1]


@pytest.mark.parametrize(
    ("temperature", "more", "found"),
    [
        ("", "tpdo: {trigger: timer}, ", "trigger: expected period_ms with trigger timer"),
        ("", "tpdo: {period_ms: 5}, ", "period_ms: expected no period with trigger sync"),
        ("", "tpdo: {trigger: event}, ", "for the time in which the position does not change"),
        ("", "tpdo: {trigger: timer, period_ms: 50}, ", "expected more than tpdo.period_ms (50)"),
        ("", "tpdo: {trigger: clock}, ", "sync, timer, event"),
        ("poll_ms: 10000", "", "poll_ms: expected less than stale_s (10 s)"),
        ("status: {index: 0x6150, subindex: 1, poll_ms: 20000}", "", "expected less than stale_s"),
        ("node_id: 128", "", "1 to 127"),
    ],
)
def test_contradictions_are_named(temperature: str, more: str, found: str) -> None:
    with pytest.raises(ContractError) as caught:
        parsed(joint(1, temperature, more))
    assert found in str(caught.value)


def test_a_scale_that_no_decimal_digits_can_mean_is_a_fault() -> None:
    text = HEAD + joint(1).replace("degc_per_unit: 0.01", "degc_per_unit: 0.0625")
    with pytest.raises(ContractError, match=r"check_digits: false"):
        parse_config(text, source="t.yaml")
    parse_config(text.replace("0.0625", "0.0625, check_digits: false"), source="t.yaml")
