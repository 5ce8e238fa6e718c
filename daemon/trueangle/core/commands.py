"""Commands from a PLC: preset (a joint's zero as the user sees it), clear fault, reference angle.

Rules of this file: nothing here waits, reads a clock or touches a file. A preset takes two commands, arm and
confirm, from one connection, at standstill, on a valid joint, with the same words; the angle in force changes only
after the new zero is on the disk. A stored zero belongs to one encoder with one model (`PresetBinding`): on any
other it is not applied, and the joint is not referenced until somebody sets or removes the preset.
"""

import enum
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from trueangle.contract.units import MILLIARCSEC_PER_TURN
from trueangle.core.presets import Preset, PresetBinding
from trueangle.core.register_fields import SLOTS

ARMED_NS = 5_000_000_000
"""A preset that is not confirmed within this time is forgotten."""
OBSERVED_NS = 100_000_000
"""A confirmation before this is too early: over less, a slow movement cannot be told from standstill."""
STANDSTILL_DEG_S = 0.1
"""Slower is standstill; one count of a 20-bit encoder between two samples at 5 ms is 0.07 deg/s."""
STANDSTILL_DEG = 0.01
"""A joint that moved further between arming and confirming is not where the preset was meant."""

_MAS_PER_DEG = 3_600_000.0
_ANGLE_TOP = MILLIARCSEC_PER_TURN - 1


class Command(enum.IntEnum):
    """Numbers of the command register; once given, never re-used."""

    ARM_PRESET = 1
    CONFIRM = 2
    ARM_REMOVAL = 3
    CANCEL = 4
    CLEAR_FAULT = 5
    REFERENCE_ANGLE = 6


COMMAND_MEANING: dict[Command, str] = {
    Command.ARM_PRESET: "get ready to make this position of the joint read `angle`; confirm within 5 s",
    Command.CONFIRM: "do what was armed; slot and angle repeated, at least 0.1 s after arming, at standstill",
    Command.ARM_REMOVAL: "get ready to remove the joint's preset; confirm within 5 s",
    Command.CANCEL: "forget what was armed",
    Command.CLEAR_FAULT: "acknowledge latched faults of the joint; what still holds comes back",
    Command.REFERENCE_ANGLE: "log `angle`, read on a reference at standstill, beside the readings of the joint",
}


class Result(enum.IntEnum):
    """Numbers of the result register; once given, never re-used."""

    NONE = 0
    DONE = 1
    ARMED = 2
    PENDING = 3
    NO_JOINT = 10
    ANGLE_RANGE = 11
    UNKNOWN_COMMAND = 12
    NOT_VALID = 13
    MOVING = 14
    NOT_ARMED = 15
    EXPIRED = 16
    TOO_EARLY = 17
    DIFFERS = 18
    STORAGE_FAILED = 19
    BUSY = 20


RESULT_MEANING: dict[Result, str] = {
    Result.NONE: "no command yet",
    Result.DONE: "done",
    Result.ARMED: "armed, waits for the confirmation",
    Result.PENDING: "being written to the disk; not in force yet",
    Result.NO_JOINT: "no joint in this slot (exception 03)",
    Result.ANGLE_RANGE: "angle outside 0 to 1295999999 (exception 03)",
    Result.UNKNOWN_COMMAND: "no such command (exception 03)",
    Result.NOT_VALID: "the joint's angle is not valid, or its encoder not identified (exception 04)",
    Result.MOVING: "the joint is not at standstill, or moved since it was armed (exception 04)",
    Result.NOT_ARMED: "nothing armed, or another connection armed this joint since (exception 04)",
    Result.EXPIRED: "armed longer than 5 s ago (exception 04)",
    Result.TOO_EARLY: "confirmed within 0.1 s of arming; still armed (exception 04)",
    Result.DIFFERS: "slot, angle, encoder or model differ from what was armed (exception 04)",
    Result.STORAGE_FAILED: "the preset could not be stored and is not in force (exception 04)",
    Result.BUSY: "a preset is being stored (exception 06)",
}

GOOD_RESULTS = frozenset({Result.NONE, Result.DONE, Result.ARMED, Result.PENDING})


@dataclass(frozen=True, slots=True, kw_only=True)
class Peer:
    """Who is connected, and what it may do."""

    address: str
    """Host address, or the serial device."""
    role: str = ""
    """Role of the client certificate; empty: none."""
    may_read: bool = True
    may_command: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class JointSituation:
    """What a command needs to know of a configured joint at this moment."""

    valid: bool
    """The corrected angle is served as good now."""
    model_deg: float | None
    """Corrected angle before the user's zero is taken off; None: none is valid."""
    velocity_deg_s: float | None
    """None: not known, which is no standstill."""
    binding: PresetBinding | None
    """Encoder and model in service; None: the encoder is not identified."""


class CommandTarget(Protocol):
    """What commands act on: the joints of the running service."""

    def situation(self, slot: int) -> JointSituation | None:
        """None: no joint is configured in this slot."""
        ...

    def set_user_zero(self, slot: int, user_zero_mas: int | None) -> None:
        """Take this off every corrected angle from now on, 0..1295999999.

        None: a preset is stored that belongs to another encoder or model, so nobody knows what the user's angle
        is; the joint must not be served as valid (NOT_REFERENCED).
        """
        ...

    def remove_preset(self, slot: int) -> None:
        """No preset: the zero of the configuration is taken off from now on."""
        ...

    def clear_fault(self, slot: int) -> None:
        """Acknowledge latched faults; one that still holds comes back at the next judgement."""
        ...

    def log_reference(self, slot: int, reference_deg: float, peer: Peer) -> None:
        """Write the reference angle beside the readings of this moment."""
        ...


class PresetStore(Protocol):
    """Where presets outlive the process."""

    def save(self, presets: Iterable[Preset], done: Callable[[bool], None]) -> None:
        """Replace the stored presets; `done(True)` once they would survive a power failure, `done(False)` if not.

        May call `done` later, on the thread that called `save`, and must call it once.
        """
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandReport:
    """One command that was asked for, or a stored preset applied or refused, for the log."""

    event: str
    slot: int
    result: Result
    peer: Peer
    angle_mas: int | None = None
    user_zero_mas: int | None = None


@dataclass(slots=True)
class _Armed:
    """What one connection is about to do."""

    command: Command
    slot: int
    angle_mas: int
    armed_ns: int
    model_deg: float | None
    """Where the joint stood; None: not known, only when a preset is removed."""
    binding: PresetBinding | None
    """What it was then; None: not known, only when a preset is removed."""


class CommandDesk:
    """All presets of the daemon and the commands that change them; connections talk to it through sessions."""

    def __init__(
        self,
        target: CommandTarget,
        store: PresetStore,
        *,
        presets: Iterable[Preset],
        report: Callable[[CommandReport], None],
    ) -> None:
        """Until `identified` says whose encoder it is, a joint with a stored preset is not referenced."""
        self._target = target
        self._store = store
        self._report = report
        self._presets = {preset.slot: preset for preset in presets}
        self._armed: dict[int, CommandSession] = {}
        self._saving = False
        self.restore()

    @property
    def presets(self) -> Mapping[int, Preset]:
        """The stored presets by slot."""
        return self._presets

    def identified(self, slot: int, binding: PresetBinding) -> None:
        """The node of this joint was read: its preset applies if it was made with this encoder and this model."""
        preset = self._presets.get(slot)
        if preset is None:
            self._target.remove_preset(slot)
            return
        applies = preset.binding == binding
        self._target.set_user_zero(slot, preset.user_zero_mas if applies else None)
        self._report(
            CommandReport(
                event="preset_applied" if applies else "preset_of_other_encoder",
                slot=slot,
                result=Result.DONE if applies else Result.DIFFERS,
                peer=Peer(address="stored"),
                user_zero_mas=preset.user_zero_mas,
            )
        )

    def has_joint(self, slot: int) -> bool:
        """Whether a joint is configured in this slot."""
        return self._target.situation(slot) is not None

    def restore(self) -> None:
        """The joints were arranged anew: what is in force for each follows from its encoder and model again."""
        for slot in range(1, SLOTS + 1):
            situation = self._target.situation(slot)
            if situation is None:
                continue
            if situation.binding is not None:
                self.identified(slot, situation.binding)
            elif slot in self._presets:
                self._target.set_user_zero(slot, None)

    def session(self, peer: Peer) -> "CommandSession":
        """The commands of one connection."""
        return CommandSession(self, peer)

    def execute(self, session: "CommandSession", number: int, slot: int, angle_mas: int, now_ns: int) -> Result:
        """Do or refuse one command, and report it; a refusal that only repeats itself is reported once.

        A PLC program asks in every cycle until it gets what it wants.
        """
        if number not in tuple(Command):
            result, event = Result.UNKNOWN_COMMAND, f"command_{number}"
        else:
            command = Command(number)
            event = command.name.lower()
            situation = self._target.situation(slot)
            if situation is None:
                result = Result.NO_JOINT
            elif not 0 <= angle_mas <= _ANGLE_TOP:
                result = Result.ANGLE_RANGE
            else:
                result = self._do(session, command, slot, angle_mas, situation, now_ns)
        refusal = None if result in GOOD_RESULTS else (event, slot, result)
        if result is Result.TOO_EARLY or (refusal is not None and refusal == session.refusal):
            return result
        session.refusal = refusal
        self._report(CommandReport(event=event, slot=slot, result=result, peer=session.peer, angle_mas=angle_mas))
        return result

    def forget(self, session: "CommandSession") -> None:
        """The connection is gone or has cancelled: what it had armed is void."""
        armed, session.armed = session.armed, None
        if armed is not None and self._armed.get(armed.slot) is session:
            del self._armed[armed.slot]

    def _do(
        self,
        session: "CommandSession",
        command: Command,
        slot: int,
        angle_mas: int,
        situation: JointSituation,
        now_ns: int,
    ) -> Result:
        if command is Command.CONFIRM:
            return self._confirm(session, slot, angle_mas, situation, now_ns)
        if command is Command.CANCEL:
            self.forget(session)
            return Result.DONE
        if command is Command.CLEAR_FAULT:
            self._target.clear_fault(slot)
            return Result.DONE
        if command is Command.REFERENCE_ANGLE:
            if not _stands(situation):
                return Result.MOVING
            self._target.log_reference(slot, angle_mas / _MAS_PER_DEG, session.peer)
            return Result.DONE
        refusal = _refusal(command, situation)
        if refusal is not None:
            return refusal
        self.forget(session)
        if (other := self._armed.get(slot)) is not None:
            self.forget(other)
        session.armed = _Armed(command, slot, angle_mas, now_ns, situation.model_deg, situation.binding)
        self._armed[slot] = session
        return Result.ARMED

    def _confirm(
        self, session: "CommandSession", slot: int, angle_mas: int, situation: JointSituation, now_ns: int
    ) -> Result:
        armed = session.armed
        if armed is None:
            return Result.NOT_ARMED
        if armed.armed_ns <= now_ns < armed.armed_ns + OBSERVED_NS:
            return Result.TOO_EARLY
        if self._saving:
            return Result.BUSY
        self.forget(session)
        if not armed.armed_ns <= now_ns <= armed.armed_ns + ARMED_NS:
            return Result.EXPIRED
        if (slot, angle_mas) != (armed.slot, armed.angle_mas):
            return Result.DIFFERS
        refusal = _refusal(armed.command, situation)
        if refusal is not None:
            return refusal
        if armed.command is Command.ARM_REMOVAL:
            return self._save(session, slot, None)
        if armed.model_deg is None or situation.model_deg is None or situation.binding is None:
            return Result.NOT_VALID
        if situation.binding != armed.binding:
            return Result.DIFFERS
        moved_deg = (situation.model_deg - armed.model_deg + 180.0) % 360.0 - 180.0
        if not abs(moved_deg) <= STANDSTILL_DEG:
            return Result.MOVING
        user_zero_mas = (round(situation.model_deg * _MAS_PER_DEG) - angle_mas) % MILLIARCSEC_PER_TURN
        return self._save(session, slot, Preset(slot=slot, user_zero_mas=user_zero_mas, binding=situation.binding))

    def _save(self, session: "CommandSession", slot: int, preset: Preset | None) -> Result:
        """Store first, then put in force: a preset in force that a restart would lose is a wrong angle later."""
        presets = {key: value for key, value in self._presets.items() if key != slot}
        if preset is not None:
            presets[slot] = preset
        self._saving = True
        session.result = Result.PENDING

        def done(stored: bool) -> None:
            self._saving = False
            if stored:
                self._presets = presets
                self._put_in_force(slot, preset)
            session.result = Result.DONE if stored else Result.STORAGE_FAILED
            self._report(
                CommandReport(
                    event="preset_stored",
                    slot=slot,
                    result=session.result,
                    peer=session.peer,
                    user_zero_mas=0 if preset is None else preset.user_zero_mas,
                )
            )

        self._store.save(presets.values(), done)
        return session.result

    def _put_in_force(self, slot: int, preset: Preset | None) -> None:
        """The encoder may have been exchanged while the disk was busy."""
        situation = self._target.situation(slot)
        if situation is None:
            return
        if preset is None:
            self._target.remove_preset(slot)
        elif situation.binding == preset.binding:
            self._target.set_user_zero(slot, preset.user_zero_mas)
        else:
            self._target.set_user_zero(slot, None)


def _stands(situation: JointSituation) -> bool:
    return situation.velocity_deg_s is not None and abs(situation.velocity_deg_s) <= STANDSTILL_DEG_S


def _refusal(command: Command, situation: JointSituation) -> Result | None:
    """Why this joint cannot have its zero moved now; a joint that serves no angle can lose its preset."""
    if not situation.valid:
        return None if command is Command.ARM_REMOVAL else Result.NOT_VALID
    if situation.model_deg is None or situation.binding is None:
        return Result.NOT_VALID
    return None if _stands(situation) else Result.MOVING


class CommandSession:
    """The command block as one connection sees it: what it has written, armed, and got as result."""

    __slots__ = ("_angle", "_count", "_desk", "_slot", "armed", "peer", "refusal", "result")

    def __init__(self, desk: CommandDesk, peer: Peer) -> None:
        self._desk = desk
        self.peer = peer
        self.armed: _Armed | None = None
        self.result = Result.NONE
        self.refusal: tuple[str, int, Result] | None = None
        """What was refused last; None after a command that was not."""
        self._slot = 0
        self._angle = 0
        """INT32 as its two registers hold it, unsigned."""
        self._count = 0

    def registers(self, now_ns: int) -> tuple[int, ...]:
        """The block as 16-bit numbers, in the order of `register_fields.COMMAND_WRITABLE + COMMAND_ANSWER`."""
        armed_slot = left_ms = 0
        if self.armed is not None:
            left_ms = (self.armed.armed_ns + ARMED_NS - now_ns) // 1_000_000
            armed_slot = self.armed.slot if left_ms > 0 else 0
        high, low = divmod(self._angle, 1 << 16)
        shown = (self.result, armed_slot, max(0, left_ms), self._count & 0xFFFF)
        # The command register reads 0, so a masked write (FC 22) of it repeats nothing.
        return (self._slot, high, low, 0, *(int(number) for number in shown))

    def write(self, offset: int, numbers: Iterable[int], now_ns: int) -> Result:
        """Take in the writable registers from `offset`; execute if the command register is one of them."""
        written = [self._slot, self._angle >> 16, self._angle & 0xFFFF, 0]
        for place, number in enumerate(numbers, offset):
            written[place] = number
        self._slot, command = written[0], written[3]
        self._angle = written[1] << 16 | written[2]
        return self.execute(command, self._slot, self._angle, now_ns) if command else Result.NONE

    def execute(self, number: int, slot: int, angle_mas: int, now_ns: int) -> Result:
        """One command with its words; the result stays readable until the next."""
        self._count += 1
        self.result = self._desk.execute(self, number, slot, angle_mas, now_ns)
        return self.result

    def close(self) -> None:
        """The connection is gone."""
        self._desk.forget(self)

    def has_joint(self, slot: int) -> bool:
        """Whether a joint is configured in this slot."""
        return self._desk.has_joint(slot)
