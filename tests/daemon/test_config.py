"""The configuration is legal as a whole or refused with every fault and its line."""

from pathlib import Path

import pytest

from trueangle.config import load_config, parse_config
from trueangle.contract.errors import ContractError

ROOT = Path(__file__).parents[2]
GOOD = """\
schema_version: 1
buses:
  - {name: arm, interface: virtual, channel: c0, sync_period_ms: 5}
joints:
  - slot: 1
    name: base
    bus: arm
    node_id: 1
    model: base.onnx
    encoder: {counts_per_rev: 3276800}
    temperature: {index: 0x7130, subindex: 1, degc_per_unit: 0.01}
  - slot: 2
    name: elbow
    bus: arm
    node_id: 2
    model: elbow.onnx
    encoder: {counts_per_rev: 3276800, settings: {serial_number: 12}}
    temperature: {index: 0x7130, subindex: 1, degc_per_unit: 0.01}
"""


def faults_of(text: str) -> list[str]:
    with pytest.raises(ContractError) as caught:
        parse_config(text, source="t.yaml")
    return [str(fault) for fault in caught.value.faults]


def test_a_good_configuration_has_safe_defaults() -> None:
    config = parse_config(GOOD, source="t.yaml")
    assert config.modbus.host == "127.0.0.1"
    assert [joint.slot for joint in config.joints] == [1, 2]
    assert config.joints[1].encoder.settings.serial_number == 12
    assert config.joints[0].sequence is None


def test_the_shipped_example_is_good() -> None:
    config = load_config(ROOT / "deploy" / "trueangled.yaml")
    assert config.joints[0].temperature.index == 0x7130


@pytest.mark.parametrize(
    ("change", "found"),
    [
        (
            ("node_id: 2", "node_id: 1"),
            "line 15, joints[1].node_id: expected a node of its own, found node 1 on bus arm",
        ),
        (("slot: 2", "slot: 1"), "line 12, joints[1].slot: expected registers of its own, found 1, which is also"),
        (("name: elbow", "name: base"), "line 13, joints[1].name: expected a name of its own"),
        (
            ("  bus: arm\n    node_id: 2", "  bus: leg\n    node_id: 2"),
            "joints[1].bus: expected one of the buses: arm",
        ),
        (("node_id: 2", "node: 2"), "line 15, joints[1].node: expected a known key, found unknown key node"),
        (("node_id: 2", "node_id: two"), "line 15, joints[1].node_id: expected a whole number, 1 to 127"),
        (("node_id: 2", "node_id: 128"), "expected a whole number, 1 to 127, found 128"),
        (("slot: 2", "slot: 33"), "expected a whole number, 1 to 32, found 33"),
        (("counts_per_rev: 3276800}", "counts_per_rev: 1.5}"), "expected a whole number, 2 to"),
        (("sync_period_ms: 5", "sync_period_ms: 0"), "sync_period_ms: expected a number, 0.5 to 10000, found 0"),
        (("subindex: 1,", "subindex: 1, bits: 12,"), "bits: expected 8, 16 or 32, found 12"),
        (("node_id: 2", "node_id: 010"), "joints[1].node_id: expected a plain decimal or 0x number, found 010"),
        (("node_id: 2", "node_id: 1:10"), "expected a plain decimal or 0x number, found 1:10"),
        (("index: 0x7130", "index: 0x6004"), "index: expected the object of a temperature, found 0x6004"),
        (
            ("node_id: 2", "node_id: 2\n    stale_ms: 5"),
            "stale_ms: expected more than the sync_period_ms of its bus",
        ),
        (("degc_per_unit: 0.01", "degc_per_unit: 1e-2"), "found the text '1e-2'; write 0.01"),
        (
            ("\njoints:", "\n  - {name: leg, interface: virtual, channel: c0}\njoints:"),
            "buses[1].channel: expected a bus of its own",
        ),
        (("schema_version: 1", "schema_version: 2"), "line 1, schema_version"),
        (("schema_version: 1\n", ""), "expected the key schema_version"),
    ],
)
def test_each_fault_names_its_line_and_what_belongs_there(change: tuple[str, str], found: str) -> None:
    assert change[0] in GOOD
    assert any(found in fault for fault in faults_of(GOOD.replace(*change, 1)))


def test_faults_in_different_places_are_reported_together() -> None:
    text = GOOD.replace("node_id: 2", "node_id: x").replace("index: 0x7130", "index: 7", 1)
    assert len(faults_of(text)) == 2


def test_a_file_that_cannot_be_read_is_a_fault(tmp_path: Path) -> None:
    with pytest.raises(ContractError, match=r"nowhere\.yaml: expected a readable file, found No such file"):
        load_config(tmp_path / "nowhere.yaml")
    (tmp_path / "latin.yaml").write_bytes(b"a: 1\nb: \xe9\n")
    with pytest.raises(ContractError, match=r"latin\.yaml line 2: expected UTF-8 text"):
        load_config(tmp_path / "latin.yaml")
    (tmp_path / "big.yaml").write_bytes(b"#" * 200_001)
    with pytest.raises(ContractError, match="expected at most 200000 bytes"):
        load_config(tmp_path / "big.yaml")


SECURE = "tls: {certificate: a, private_key: b, client_ca: c, roles: {setter: command, viewer: read}}"


def test_modbus_with_everything_is_good() -> None:
    modbus = (
        f"modbus: {{allow: [192.0.2.0/24, 2001:db8::1], {SECURE}, commands: true, plain_tcp: false, "
        "rtu: {device: /dev/ttyS0, baudrate: 115200, parity: none, stop_bits: 2, unit_id: 9}}\n"
    )
    config = parse_config(modbus + GOOD, source="t.yaml").modbus
    assert config.tls is not None
    assert config.tls.port == 802
    assert config.tls.roles["setter"].value == "command"
    assert config.rtu is not None
    assert (config.rtu.parity.value, config.rtu.unit_id) == ("none", 9)
    assert [str(network) for network in config.networks] == ["192.0.2.0/24", "2001:db8::1/128"]


@pytest.mark.parametrize(
    ("modbus", "found"),
    [
        ("allow: [192.0.2.1/24]", "modbus.allow[0]: expected an address or a network such as 192.0.2.0/24"),
        ("allow: [plc]", "modbus.allow[0]"),
        ("plain_tcp: false", "modbus.plain_tcp: expected tls or rtu where it is false, found no server"),
        ("insecure_commands: true", "modbus.insecure_commands: expected commands: true with it"),
        (
            "commands: true",
            "modbus.commands: expected a role of tls.roles mapped to command, or insecure_commands",
        ),
        (f"{SECURE.replace('command', 'read')}, commands: true", "modbus.commands: expected a role"),
        (SECURE.replace("command", "write"), "modbus.tls.roles.setter: expected one of read, command"),
        ("tls: {certificate: a, private_key: b}", "modbus.tls: expected the key client_ca"),
        ("rtu: {device: x, baudrate: 12345}", "modbus.rtu.baudrate: expected one of 1200"),
        ("rtu: {device: x, unit_id: 0}", "modbus.rtu.unit_id: expected a whole number, 1 to 247"),
    ],
)
def test_modbus_that_contradicts_itself_is_refused(modbus: str, found: str) -> None:
    assert any(found in fault for fault in faults_of(f"modbus: {{{modbus}}}\n" + GOOD))


@pytest.mark.parametrize(
    ("key", "found"),
    [
        ("when_not_valid: {policy: hold}", "expected hold_ms with policy hold and only with it"),
        ("when_not_valid: {policy: raw}", "expected allow_raw: true with policy raw and only with it"),
        ("when_not_valid: {policy: marker, allow_raw: true}", "expected allow_raw: true with policy raw"),
        ("when_not_valid: {hold_ms: 20}", "expected hold_ms with policy hold"),
        (
            "further_heads: [{node_id: 1, mounting_deg: 180, encoder: {counts_per_rev: 4096}}]",
            "joints[1].further_heads[0].node_id: expected a node of its own",
        ),
        (
            "further_heads: [{node_id: 9, bus: leg, mounting_deg: 180, encoder: {counts_per_rev: 4096}}]",
            "joints[1].further_heads[0].bus: expected the joint's own bus, arm: heads on two buses have no SYNC",
        ),
    ],
)
def test_what_stands_in_for_an_angle_and_reads_it_must_be_said_in_full(key: str, found: str) -> None:
    assert any(found in fault for fault in faults_of(GOOD + f"    {key}\n")), faults_of(GOOD + f"    {key}\n")


@pytest.mark.parametrize(
    ("sensor", "found"),
    [
        ("bus: leg, node_id: 40", "joints[0].temperature.bus: expected one of the buses: arm, found leg"),
        ("bus: arm", "joints[0].temperature.bus: expected node_id with bus: which node there measures it"),
        ("node_id: 2", "joints[0].temperature.index: expected the object of a temperature: node 2 is an"),
        ("node_id: 9", "joints[0].temperature.node_id: expected a node that is no further reading head"),
    ],
)
def test_a_temperature_that_no_node_could_tell_is_refused(sensor: str, found: str) -> None:
    heads = "    further_heads: [{node_id: 9, bus: arm, mounting_deg: 180, encoder: {counts_per_rev: 3276800}}]\n"
    text = GOOD.replace("degc_per_unit: 0.01", f"degc_per_unit: 0.01, {sensor}", 1) + heads
    text = text.replace("index: 0x7130", "index: 0x6401", 1) if "node_id: 2" in sensor else text
    assert any(found in fault for fault in faults_of(text)), faults_of(text)


@pytest.mark.parametrize(
    ("encoder", "found"),
    [
        ("direction: 0", "direction: expected 1 or -1, found 0"),
        ("gear_ratio: {motor_turns: 100, joint_turns: 1}", "expected settings.total_range_units with a gear"),
        ("reference: {index: 0x2200, subindex: 0}", "expected none with an absolute encoder, or absolute: false"),
    ],
)
def test_an_encoder_whose_angle_cannot_be_known_is_refused(encoder: str, found: str) -> None:
    text = GOOD.replace("{counts_per_rev: 3276800}", f"{{counts_per_rev: 3276800, {encoder}}}", 1)
    assert any(found in fault for fault in faults_of(text)), faults_of(text)


@pytest.mark.parametrize("odd", [r"a\0b", r"\uD800"])
@pytest.mark.parametrize(
    ("line", "where"),
    [
        ("modbus: {{host: {0}}}", "modbus.host"),
        ("modbus: {{tls: {{certificate: {0}, private_key: k, client_ca: c}}}}", "modbus.tls.certificate"),
        ("modbus: {{tls: {{certificate: c, private_key: {0}, client_ca: c}}}}", "modbus.tls.private_key"),
        ("modbus: {{rtu: {{device: {0}}}}}", "modbus.rtu.device"),
        ("metrics: {{port: 1, host: {0}}}", "metrics.host"),
        ("state_directory: {0}", "state_directory"),
    ],
)
def test_a_text_that_no_file_or_host_can_be_called_is_a_fault_of_its_line(line: str, where: str, odd: str) -> None:
    (fault,) = faults_of(GOOD + line.format(f'"{odd}"') + "\n")
    number = GOOD.count("\n") + 1
    assert fault.startswith(f"t.yaml line {number}, {where}: expected a text without NUL and half characters")
    assert fault.isprintable()


@pytest.mark.parametrize("key", ["channel", "eds"])
def test_so_is_one_inside_a_bus_or_a_joint(key: str) -> None:
    odd = '"a\\0b"'
    text = GOOD.replace("channel: c0", f"channel: {odd}") if key == "channel" else GOOD + f"    eds: {odd}\n"
    (fault,) = faults_of(text)
    assert f"{key}: expected a text without NUL" in fault
