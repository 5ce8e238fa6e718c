"""`trueangled commission`: reads a node, says what differs, and writes only what it is told to, step by step.

Rules of this file: one yes for one step; the undo file is on disk before the first write; every write is read
back; storing is a step of its own; without a terminal only steps named by --yes are done.
"""

import argparse
import asyncio
import datetime
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from trueangle.commands import Commands
from trueangle.commands.bus_tool import BusSession, add_bus, add_lss_timeout, bus_of, lss_timeout_faults
from trueangle.config import DaemonConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.core import lss
from trueangle.core.bus_survey import BusSurvey
from trueangle.core.commissioning import (
    STORE,
    STORE_SIGNATURE,
    OldLayer,
    OldNode,
    OldObject,
    UndoRecord,
    changed_objects,
    exact_differences,
    identity_of,
    settings_yaml,
    setup_addresses,
    setup_expected,
    setup_writes,
    undo_expected,
    undo_from_json,
    undo_to_json,
    undo_writes,
)
from trueangle.core.node_setup import (
    ENCODER_OBJECTS,
    PROFILE_SERIAL,
    Address,
    SdoWrite,
    readback_differences,
    settings_from,
    shown,
)
from trueangle.edges.terminal import Progress, ask, says_yes
from trueangle.edges.undo_file import read_undo, write_undo
from trueangle.errors import LinkError, NodeFault
from trueangle.service import LoadedJoint, encoder_differences, load_joints, node_plan

LISTEN_S = 1.5
"""The daemon reads the encoders' settings once a second: it is heard within this."""
STEPS = ("node-id", "bitrate", "lss-store", "setup", "store", "undo")
NMT_PRE_OPERATIONAL = 0x80


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "commission",
        help="read a node, compare it, set it up step by step",
        description="Read a node, propose its configuration, and set it up step by step. Each step is asked; "
        "an undo file is written first. Nothing that moves the encoder's phase is ever written.",
        epilog="Example: trueangled commission --config trueangled.yaml --joint base; "
        "a factory unit: --new-node-id 5 --identity 0x159:0x1234:0x10002:4711",
    )
    add_bus(parser)
    parser.add_argument("--joint", metavar="NAME", help="one joint of the configuration (default: all of the bus)")
    parser.add_argument("--node-id", type=int, metavar="N", help="a node without a configuration: only read it")
    parser.add_argument("--new-node-id", type=int, metavar="N", help="give one unit this node-id (CiA 305)")
    parser.add_argument("--new-bitrate", type=int, metavar="BIT/S", help="give one unit this bit rate (CiA 305)")
    parser.add_argument("--identity", metavar="V:P:R:S", help="which unit: vendor, product, revision, serial")
    add_lss_timeout(parser)
    parser.add_argument("--undo", type=Path, metavar="FILE", help="put back what this undo file says")
    parser.add_argument("--undo-file", type=Path, metavar="FILE", help="where to write the undo file")
    parser.add_argument(
        "--yes",
        action="append",
        default=[],
        choices=STEPS,
        metavar="STEP",
        help=f"do it unasked: {', '.join(STEPS)}",
    )
    parser.set_defaults(command=_commission)


class _Person:
    """Who says yes."""

    def __init__(self, agreed: Sequence[str]) -> None:
        self._agreed = agreed
        self.left_out = False

    def agrees(self, step: str, question: str) -> bool:
        """Whether this step is to be done."""
        if step in self._agreed:
            print(f"{question} --yes {step}")
            return True
        if says_yes(ask(f"{question} Type yes to do it: ", keyboard=sys.stdin, screen=sys.stdout)):
            return True
        self.left_out = True
        why = "" if sys.stdin.isatty() else f" (no terminal; --yes {step} does it)"
        print(f"{step}: not done{why}")
        return False


class _Undo:
    """The undo file of this run."""

    def __init__(self, path: Path | None, bus: str) -> None:
        now = datetime.datetime.now(datetime.UTC)
        stem = re.sub(r"[^A-Za-z0-9._-]", "_", bus)
        self.path = path or Path(f"trueangle-undo-{stem}-{now:%Y%m%dT%H%M%SZ}.json")
        self._record = UndoRecord(made=now.isoformat(timespec="seconds"), bus=bus)
        self._written = False

    def add(self, *, node: OldNode | None = None, layer: OldLayer | None = None) -> None:
        """On disk when this returns."""
        self._record = replace(
            self._record,
            nodes=self._record.nodes + (() if node is None else (node,)),
            layers=self._record.layers + (() if layer is None else (layer,)),
        )
        write_undo(self.path, undo_to_json(self._record), replace=self._written)
        if not self._written:
            print(f"undo file: {self.path}")
        self._written = True


def _commission(options: argparse.Namespace) -> int:
    bus, config = bus_of(options)
    faults = _option_faults(options, config)
    if faults:
        raise ContractError(faults)
    identity = None if options.identity is None else _identity(options.identity)
    record = None
    if options.undo is not None:
        record = undo_from_json(read_undo(options.undo), source=str(options.undo))
    joints = _joints(options, config, bus.name)
    person, undo = _Person(options.yes), _Undo(options.undo_file, bus.name)

    async def work() -> int:
        async with BusSession(bus, lss_s=options.lss_timeout) as session:
            await _expect_no_other_master(session)
            if record is not None:
                return await _put_back(session, record, person)
            if options.new_node_id is not None or options.new_bitrate is not None:
                await _layer(session, options, identity, person, undo)
                return 1 if person.left_out else 0
            if options.node_id is not None:
                settings = await _settings(session, options.node_id)
                print(f"node {options.node_id}\n{settings_yaml(settings)}")
                return 0
            good = True
            for joint in joints:
                good &= await _set_up(session, joint, person, undo)
            return 0 if good else 1

    return asyncio.run(work())


def _option_faults(options: argparse.Namespace, config: DaemonConfig | None) -> list[Fault]:
    faults: list[Fault] = []
    for name, value in (("--node-id", options.node_id), ("--new-node-id", options.new_node_id)):
        if value is not None and not 1 <= value <= 127:
            faults.append(Fault(where=name, expected="1 to 127", found=str(value)))
    if options.new_bitrate is not None and options.new_bitrate not in lss.BIT_TIMING_INDEX:
        expected = f"one of {', '.join(map(str, lss.BIT_TIMING_INDEX))}"
        faults.append(Fault(where="--new-bitrate", expected=expected, found=str(options.new_bitrate)))
    faults += lss_timeout_faults(options)
    named = (options.undo, options.new_node_id, options.new_bitrate, options.node_id)
    if config is None and all(option is None for option in named):
        expected = "--config FILE, --node-id, --new-node-id, --new-bitrate or --undo"
        faults.append(Fault(where="command line", expected=expected, found="none of them"))
    return faults


def _joints(options: argparse.Namespace, config: DaemonConfig | None, bus: str) -> list[LoadedJoint]:
    if config is None or options.undo is not None:
        return []
    here = [joint for joint in config.joints if joint.bus == bus]
    if options.joint is not None:
        here = [joint for joint in config.joints if joint.name == options.joint]
        if not here or here[0].bus != bus:
            expected = f"a joint of bus {bus}"
            raise ContractError([Fault(where="--joint", expected=expected, found=options.joint)])
    loaded = load_joints(config, base=options.config.parent, source=str(options.config))
    return [joint for joint in loaded if joint.config in here]


def _identity(text: str) -> lss.LssIdentity:
    try:
        vendor, product, revision, serial = (int(part, 0) for part in text.split(":"))
        return lss.LssIdentity(
            vendor_id=vendor, product_code=product, revision_number=revision, serial_number=serial
        )
    except ValueError as error:
        expected = "vendor:product:revision:serial, four numbers as 0x159 or 345"
        raise ContractError([Fault(where="--identity", expected=expected, found=text)]) from error


async def _expect_no_other_master(session: BusSession) -> None:
    survey = BusSurvey()
    session.listener = survey.take
    with Progress(sys.stderr, "listen") as progress:
        for step in range(10):
            progress(step / 10)
            await asyncio.sleep(LISTEN_S / 10)
    session.listener = None
    if survey.other_master:
        raise LinkError(
            f"bus {session.settings.name}: another master speaks here ({survey.other_master}); "
            "stop it first: systemctl stop trueangled"
        )


async def _settings(session: BusSession, node_id: int) -> EncoderSettings:
    addresses = (*ENCODER_OBJECTS.values(), PROFILE_SERIAL)
    values = {address: await session.value(node_id, address) for address in addresses}
    if node_id in session.doubled:
        raise NodeFault(
            f"two units answer to node-id {node_id}: give each its own with --new-node-id and --identity; "
            "trueangled scan --lss VENDOR:PRODUCT lists their identities"
        )
    return settings_from(values)


# Layer setting services


async def _layer(
    session: BusSession,
    options: argparse.Namespace,
    identity: lss.LssIdentity | None,
    person: _Person,
    undo: _Undo,
) -> None:
    try:
        identity = await _selected(session, identity)
        before = await session.lss(lss.inquire_node_id())
        print(f"unit {identity} has {'no node-id' if before == 255 else f'node-id {before}'}")
        bitrate = options.new_bitrate
        if bitrate is not None and session.settings.bitrate is None:
            expected = "the present bit rate, so that it can be put back: bitrate of the bus, or --bitrate"
            raise ContractError([Fault(where="--new-bitrate", expected=expected, found="none")])
        vendor, product, revision, serial = identity.numbers
        old = OldLayer(
            vendor_id=vendor,
            product_code=product,
            revision_number=revision,
            serial_number=serial,
            node_id=before,
            bitrate=None if bitrate is None else session.settings.bitrate,
        )
        changed = False
        new = options.new_node_id
        if new is not None and new != before:
            if await session.upload(new, (0x1000, 0)) is not None:
                raise NodeFault(f"node-id {new} is taken: a node answers to it")
            if person.agrees("node-id", f"Give unit {identity} node-id {new} instead of {before}?"):
                undo.add(layer=old)
                changed = True
                await session.lss(lss.configure_node_id(new))
                print(f"node-id {new}: set and read back")
        if bitrate is not None and person.agrees("bitrate", f"Give unit {identity} {bitrate} bit/s?"):
            if not changed:
                undo.add(layer=old)
            changed = True
            await session.lss(lss.configure_bit_rate(bitrate))
            print(f"bit rate {bitrate}: accepted (CiA 305 has no way to read it back)")
        if changed and person.agrees("lss-store", "Store this in the unit, so that it outlives its supply?"):
            await session.lss(lss.store())
            print("stored; it is in force after the unit's next reset")
    finally:
        await session.lss(lss.switch_global(lss.WAITING))


async def _selected(session: BusSession, identity: lss.LssIdentity | None) -> lss.LssIdentity:
    """The one unit in CONFIGURATION: the named one, else one without a node-id, else the only one."""
    if identity is not None:
        await session.lss(lss.select(identity))
        return identity
    found = await session.lss(lss.fastscan())
    if found is not None:
        return found
    await session.lss(lss.switch_global(lss.CONFIGURATION))
    return await session.lss(lss.inquire_identity())


# A joint of the configuration


async def _set_up(session: BusSession, joint: LoadedJoint, person: _Person, undo: _Undo) -> bool:
    """True where nothing is left to be done."""
    config = joint.config
    settings = await _settings(session, config.node_id)
    print(f"joint {config.name}, node {config.node_id}\n{settings_yaml(settings)}")
    differences = encoder_differences(joint, settings)
    for text in differences:
        print(f"  differs: {text}")
    if differences:
        print("  not written here: it moves the phase that the model belongs to. Set it back, or calibrate anew.")
    plan = node_plan(config)
    expected = setup_expected(plan)
    found = await _objects(session, config.node_id, setup_addresses(plan))
    open_points = readback_differences(expected, {address: old.value for address, old in found.items()})
    if not open_points:
        print("  heartbeat and process data are set as configured")
        return not differences
    for text in open_points:
        print(f"  to set: {text}")
    writes = setup_writes(plan, found)
    if not person.agrees(
        "setup", f"Put node {config.node_id} into PRE-OPERATIONAL and write {len(writes)} objects?"
    ):
        return False
    undo.add(
        node=OldNode(
            node_id=config.node_id, identity=identity_of(settings), objects=changed_objects(writes, found)
        )
    )
    await _write(session, config.node_id, writes, expected, readback_differences)
    print("  set and read back; the node is left PRE-OPERATIONAL, trueangled starts it")
    return await _store(session, config.node_id, person) and not differences


async def _objects(session: BusSession, node_id: int, addresses: Sequence[Address]) -> Mapping[Address, OldObject]:
    """What the node has of these."""
    found: dict[Address, OldObject] = {}
    for address in addresses:
        answer = await session.upload(node_id, address)
        if answer is None:
            raise LinkError(f"node {node_id} does not answer (SDO read of {shown(address)})")
        if answer.value is not None:
            found[address] = OldObject(index=address[0], subindex=address[1], size=answer.size, value=answer.value)
    return found


async def _write(
    session: BusSession,
    node_id: int,
    writes: Sequence[SdoWrite],
    expected: Mapping[Address, int],
    compare: Callable[[Mapping[Address, int], Mapping[Address, int | None]], list[str]],
) -> None:
    session.send(0x000, bytes((NMT_PRE_OPERATIONAL, node_id)))
    for write in writes:
        await session.download(node_id, write)
    back = {address: await session.value(node_id, address) for address in expected}
    if differences := compare(expected, back):
        raise NodeFault(f"node {node_id} did not take its set-up: {'; '.join(differences)}; see the undo file")


async def _store(session: BusSession, node_id: int, person: _Person) -> bool:
    if await session.value(node_id, STORE) is None:
        print(f"  the unit has no object {shown(STORE)}: it cannot store, trueangled sets it up at each start")
        return True
    if not person.agrees(
        "store", f"Store all parameters of node {node_id} in its memory ({shown(STORE)} 'save')?"
    ):
        return False
    await session.download(node_id, SdoWrite(address=STORE, value=STORE_SIGNATURE, size=4), timeout_s=5.0)
    print("  stored")
    return True


# Undo


async def _put_back(session: BusSession, record: UndoRecord, person: _Person) -> int:
    for node in record.nodes:
        settings = await _settings(session, node.node_id)
        if (found := identity_of(settings)) != dict(node.identity):
            raise NodeFault(
                f"node {node.node_id}: expected the unit {dict(node.identity)}, found {found}; nothing was written"
            )
        writes = undo_writes(node.objects)
        question = f"Put {len(node.objects)} objects of node {node.node_id} back as they were on {record.made}?"
        if person.agrees("undo", question):
            await _write(session, node.node_id, writes, undo_expected(node.objects), exact_differences)
            print("  put back and read back")
            await _store(session, node.node_id, person)
    for layer in reversed(record.layers):
        await _layer_back(session, layer, person)
    return 1 if person.left_out else 0


async def _layer_back(session: BusSession, layer: OldLayer, person: _Person) -> None:
    identity = lss.LssIdentity(
        vendor_id=layer.vendor_id,
        product_code=layer.product_code,
        revision_number=layer.revision_number,
        serial_number=layer.serial_number,
    )
    if layer.node_id == 255:
        print(f"unit {identity} had no node-id: CiA 305 has no way to take one away; the maker's reset does")
    node_id = f"node-id {layer.node_id}" if layer.node_id != 255 else ""
    bitrate = f"{layer.bitrate} bit/s" if layer.bitrate is not None else ""
    wanted = " and ".join(text for text in (node_id, bitrate) if text)
    if not wanted or not person.agrees("undo", f"Give unit {identity} {wanted} again?"):
        return
    try:
        await session.lss(lss.select(identity))
        if layer.node_id != 255:
            await session.lss(lss.configure_node_id(layer.node_id))
        if layer.bitrate is not None:
            await session.lss(lss.configure_bit_rate(layer.bitrate))
        print(f"unit {identity}: {wanted} set again")
        if person.agrees("lss-store", "Store this in the unit?"):
            await session.lss(lss.store())
    finally:
        await session.lss(lss.switch_global(lss.WAITING))
