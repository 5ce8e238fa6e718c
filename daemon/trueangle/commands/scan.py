"""`trueangled scan`: what is on the bus. It listens, then it asks; it changes nothing."""

import argparse
import asyncio
import json
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from trueangle.commands import Commands
from trueangle.commands.bus_tool import BusSession, add_bus, add_lss_timeout, bus_of, lss_timeout_faults
from trueangle.config import BusConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.errors import ContractError, Fault
from trueangle.core.bus_survey import TEMPERATURE_CANDIDATES, BusSurvey
from trueangle.core.lss import LssIdentity, find_serials
from trueangle.core.node_setup import ENCODER_OBJECTS, PROFILE_SERIAL, Address, settings_from
from trueangle.edges.terminal import Progress
from trueangle.errors import LinkError

BATCH = 16
PROBE_S = 0.3
DEVICE_TYPE: Address = (0x1000, 0)
PROFILES = {401: "I/O", 402: "drive", 404: "measuring", 406: "encoder", 410: "inclinometer"}


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundNode:
    """One node and what it told. None: not known."""

    node_id: int
    settings: EncoderSettings | None
    """None: heard of, but silent on SDO or not asked."""
    temperatures: Mapping[str, int]
    """Raw values of the objects that may hold a temperature."""


def add_parser(commands: Commands) -> None:
    """The command's options."""
    parser = commands.add_parser(
        "scan",
        help="list what is on a CAN bus",
        description="List what is on a CAN bus: listen, then read the identity of nodes 1 to 127. Writes nothing.",
        epilog="Example: trueangled scan --interface socketcan --channel can0",
    )
    add_bus(parser)
    parser.add_argument("--listen-s", type=float, default=3.0, metavar="S", help="how long to listen (default 3)")
    parser.add_argument("--beside-master", action="store_true", help="ask nodes although another master does, too")
    parser.add_argument(
        "--lss",
        metavar="V:P",
        help="also list all units of this vendor and product by LSS (CiA 305), those that share a node-id "
        "included; about 10 s",
    )
    add_lss_timeout(parser)
    parser.add_argument("--json", action="store_true", help="one JSON document instead of the table")
    parser.set_defaults(command=_scan)


def _scan(options: argparse.Namespace) -> int:
    settings, _ = bus_of(options)
    faults = lss_timeout_faults(options)
    if not 0 <= options.listen_s <= 600:
        faults.append(Fault(where="--listen-s", expected="0 to 600", found=f"{options.listen_s:g}"))
    if faults:
        raise ContractError(faults)
    product = None if options.lss is None else _product(options.lss)
    survey = BusSurvey()
    nodes, units = asyncio.run(_survey(settings, survey, options, product))
    asked = not survey.other_master or options.beside_master
    if options.json:
        document = _document(settings, survey, nodes, asked=asked)
        if units is not None:
            document["lss_units"] = [str(unit) for unit in units]
        print(json.dumps(document, indent=2))
    else:
        print(_table(settings, survey, nodes, asked=asked), end="")
        if units is not None:
            print(
                "".join(f"unit {unit}\n" for unit in units) or f"no unit of {options.lss} answers by LSS\n", end=""
            )
    return 0 if nodes or units else 1


def _product(text: str) -> LssIdentity:
    """Vendor and product, the other numbers 0."""
    try:
        vendor, product = (int(part, 0) for part in text.split(":"))
        return LssIdentity(vendor_id=vendor, product_code=product, revision_number=0, serial_number=0)
    except ValueError as error:
        expected = "vendor:product, two numbers as 0x159 or 345"
        raise ContractError([Fault(where="--lss", expected=expected, found=text)]) from error


async def _survey(
    settings: BusConfig, survey: BusSurvey, options: argparse.Namespace, product: LssIdentity | None
) -> tuple[tuple[FoundNode, ...], tuple[LssIdentity, ...] | None]:
    """The nodes, and the units of the product where one was asked for and the bus is ours to ask."""
    async with BusSession(settings, lss_s=options.lss_timeout) as session:
        session.listener = survey.take
        await _listen(options.listen_s)
        if survey.other_master and not options.beside_master:
            # Two masters that ask one node at once take each other's answers.
            heard = (FoundNode(node_id=node, settings=None, temperatures={}) for node in sorted(survey.nodes()))
            return tuple(heard), None
        session.listener = None
        units = None
        if product is not None:
            # First: two units with one node-id still hold their peace.
            with Progress(sys.stderr, "LSS") as progress:
                progress(0, f"units of {options.lss}")
                units = await session.lss(find_serials(product.vendor_id, product.product_code))
        answering = await _probe(session)
        found: list[FoundNode] = []
        with Progress(sys.stderr, "read") as progress:
            for i, node_id in enumerate(sorted(answering | survey.nodes())):
                progress(i / (len(answering | survey.nodes())), f"node {node_id}")
                asked = node_id in answering
                found.append(
                    await _read(session, node_id)
                    if asked
                    else FoundNode(node_id=node_id, settings=None, temperatures={})
                )
        survey.emergencies |= dict.fromkeys(session.doubled, "two answers to one request: two nodes?")
        return tuple(found), units


async def _listen(seconds: float) -> None:
    with Progress(sys.stderr, "listen") as progress:
        for step in range(20):
            progress(step / 20)
            await asyncio.sleep(seconds / 20)


async def _probe(session: BusSession) -> set[int]:
    """Who answers a read of 0x1000, an abort included; in batches, so that the bus is not flooded."""
    answering: set[int] = set()
    with Progress(sys.stderr, "ask") as progress:
        for first in range(1, 128, BATCH):
            batch = range(first, min(first + BATCH, 128))
            progress(first / 128, f"nodes {batch[0]} to {batch[-1]}")
            answers = await asyncio.gather(
                *(session.upload(node, DEVICE_TYPE, timeout_s=PROBE_S) for node in batch)
            )
            answering |= {node for node, answer in zip(batch, answers, strict=True) if answer is not None}
    return answering


async def _read(session: BusSession, node_id: int) -> FoundNode:
    values: dict[Address, int | None] = {}
    temperatures: dict[str, int] = {}
    try:
        for address in (*ENCODER_OBJECTS.values(), PROFILE_SERIAL):
            answer = await session.upload(node_id, address)
            values[address] = None if answer is None else answer.value
        for (index, subindex), _ in TEMPERATURE_CANDIDATES:
            answer = await session.upload(node_id, (index, subindex))
            if answer is not None and answer.value is not None:
                bits = 8 * answer.size
                raw = answer.value - (1 << bits if answer.value >> (bits - 1) else 0)
                temperatures[f"0x{index:04X}:{subindex}"] = raw
    except LinkError:
        return FoundNode(node_id=node_id, settings=None, temperatures={})
    return FoundNode(node_id=node_id, settings=settings_from(values), temperatures=temperatures)


def _table(settings: BusConfig, survey: BusSurvey, nodes: Sequence[FoundNode], *, asked: bool) -> str:
    lines = [f"bus {settings.name} ({settings.interface} {settings.channel}): {survey.frames} frames heard"]
    if survey.other_master:
        advice = "" if asked else "; nodes were not asked (stop it first, or --beside-master)"
        lines.append(f"another master speaks here: {survey.other_master}{advice}")
    rows = [("node", "state", "profile", "vendor", "product", "serial", "counts/rev", "temperature candidates")]
    rows += [_row(survey, node) for node in nodes]
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    if nodes:
        lines += [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows
        ]
    else:
        lines.append(
            "no node was heard and none answers; is the bit rate right, the bus terminated, the supply on?"
        )
    for cob_id, heard in sorted(survey.heard.items()):
        rate = "once" if heard.rate_hz is None else f"{heard.rate_hz:.1f} per s"
        name = "SYNC" if cob_id == 0x080 else "process data"
        lines.append(f"0x{cob_id:03X}  {name}, {heard.length} bytes, {rate}")
    lines += [f"node {node} reports: {text}" for node, text in sorted(survey.emergencies.items())]
    return "\n".join(lines) + "\n"


def _row(survey: BusSurvey, node: FoundNode) -> tuple[str, ...]:
    state = survey.states.get(node.node_id, "no heartbeat")
    found = node.settings
    if found is None:
        return (str(node.node_id), state, "not read", "", "", "", "", "")
    profile = None if found.device_type is None else found.device_type & 0xFFFF
    candidates = ", ".join(f"{name} = {raw}" for name, raw in node.temperatures.items())
    return (
        str(node.node_id),
        state,
        "?" if profile is None else f"CiA {profile} {PROFILES.get(profile, '')}".strip(),
        _hex(found.vendor_id),
        _hex(found.product_code),
        "?" if found.serial_number is None else str(found.serial_number),
        "?" if found.counts_per_rev is None else str(found.counts_per_rev),
        candidates or "none",
    )


def _hex(number: int | None) -> str:
    return "?" if number is None else f"0x{number:X}"


def _document(
    settings: BusConfig, survey: BusSurvey, nodes: Sequence[FoundNode], *, asked: bool
) -> dict[str, object]:
    return {
        "bus": settings.name,
        "frames": survey.frames,
        "other_master": survey.other_master or None,
        "asked": asked,
        "nodes": [
            {
                "node_id": node.node_id,
                "state": survey.states.get(node.node_id),
                "boot_ups": survey.boot_ups.get(node.node_id, 0),
                "emergency": survey.emergencies.get(node.node_id),
                "settings": None if node.settings is None else node.settings.known(),
                "counts_per_rev": None if node.settings is None else node.settings.counts_per_rev,
                "temperature_candidates": dict(node.temperatures),
            }
            for node in nodes
        ],
        "process_data": [
            {"cob_id": cob_id, "length": heard.length, "frames": heard.frames, "rate_hz": heard.rate_hz}
            for cob_id, heard in sorted(survey.heard.items())
        ],
    }
