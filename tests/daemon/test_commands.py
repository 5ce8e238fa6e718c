"""Commands: armed and confirmed at standstill, stored before they are in force, bound to encoder and model."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.fakes.command_target import BINDING, FakeJoints, FakeStore

from trueangle.core.commands import (
    COMMAND_MEANING,
    GOOD_RESULTS,
    RESULT_MEANING,
    Command,
    CommandDesk,
    CommandReport,
    CommandSession,
    Peer,
    Result,
)
from trueangle.core.presets import Preset

MS = 1_000_000
TURN_MAS = 1_296_000_000
PLC = Peer(address="192.0.2.7", role="setter", may_command=True)
STORED = Preset(slot=1, user_zero_mas=360_000, binding=BINDING)


class Desk:
    """A desk over fakes, with a clock of its own."""

    def __init__(self, *presets: Preset) -> None:
        self.joints, self.store = FakeJoints(), FakeStore()
        self.reports: list[CommandReport] = []
        self.desk = CommandDesk(self.joints, self.store, presets=presets, report=self.reports.append)
        self.now_ns = 10**12
        self.session = self.desk.session(PLC)

    def ask(
        self, command: int, slot: int = 1, angle_mas: int = 0, session: CommandSession | None = None
    ) -> Result:
        return (session or self.session).execute(command, slot, angle_mas, self.now_ns)

    def wait(self, ms: float) -> None:
        self.now_ns += round(ms * MS)

    def preset(self, slot: int = 1, angle_mas: int = 0) -> Result:
        assert self.ask(Command.ARM_PRESET, slot, angle_mas) is Result.ARMED
        self.wait(200)
        return self.ask(Command.CONFIRM, slot, angle_mas)


def test_a_preset_makes_this_position_read_what_was_asked_for() -> None:
    desk = Desk()
    assert desk.preset(1, 36_000_000) is Result.DONE
    # corrected = model angle - zero: 100 deg - 90 deg = 10 deg.
    assert desk.joints.zeros[1] == 90 * 3_600_000
    assert desk.store.saved == [(Preset(slot=1, user_zero_mas=90 * 3_600_000, binding=BINDING),)]


@given(model_deg=st.floats(0, 360, exclude_max=True), angle_mas=st.integers(0, TURN_MAS - 1))
def test_any_preset_reads_what_was_asked_for_to_half_a_milliarcsecond(model_deg: float, angle_mas: int) -> None:
    desk = Desk()
    desk.joints.change(1, model_deg=model_deg)
    assert desk.preset(1, angle_mas) is Result.DONE
    zero_mas = desk.joints.zeros[1]
    assert zero_mas is not None
    assert 0 <= zero_mas < TURN_MAS
    difference = (model_deg * 3.6e6 - zero_mas - angle_mas + TURN_MAS / 2) % TURN_MAS - TURN_MAS / 2
    assert abs(difference) <= 0.5 + 1e-6


def test_confirming_without_arming_does_nothing() -> None:
    desk = Desk()
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED
    assert (desk.joints.zeros[1], desk.store.saved) == (0, [])


@pytest.mark.parametrize(
    ("after_ms", "result"),
    [(99, Result.TOO_EARLY), (100, Result.DONE), (5000, Result.DONE), (5001, Result.EXPIRED)],
)
def test_a_confirmation_comes_within_five_seconds_and_not_at_once(after_ms: float, result: Result) -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    desk.wait(after_ms)
    assert desk.ask(Command.CONFIRM) is result
    assert len(desk.store.saved) == (result is Result.DONE)


def test_a_confirmation_that_came_too_early_may_come_again_and_a_late_one_may_not() -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    assert desk.ask(Command.CONFIRM) is Result.TOO_EARLY
    desk.wait(6000)
    assert desk.ask(Command.CONFIRM) is Result.EXPIRED
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED


def test_a_clock_set_back_confirms_nothing() -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    desk.wait(-1000)
    assert desk.ask(Command.CONFIRM) is Result.EXPIRED


@pytest.mark.parametrize("words", [(2, 0), (1, 1)])
def test_a_confirmation_of_something_else_is_refused_and_disarms(words: tuple[int, int]) -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    desk.wait(200)
    assert desk.ask(Command.CONFIRM, *words) is Result.DIFFERS
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED
    assert desk.store.saved == []


@pytest.mark.parametrize("velocity", [0.11, -0.11, None, float("nan")])
def test_a_joint_that_moves_or_may_move_is_neither_armed_nor_preset(velocity: float | None) -> None:
    desk = Desk()
    desk.joints.change(1, velocity_deg_s=velocity)
    assert desk.ask(Command.ARM_PRESET) is Result.MOVING
    desk.joints.change(1, velocity_deg_s=0.0)
    desk.ask(Command.ARM_PRESET)
    desk.wait(200)
    desk.joints.change(1, velocity_deg_s=velocity)
    assert desk.ask(Command.CONFIRM) is Result.MOVING
    assert desk.store.saved == []


@pytest.mark.parametrize(
    ("deg", "result"), [(100.009, Result.DONE), (100.011, Result.MOVING), (99.5, Result.MOVING)]
)
def test_a_joint_that_was_moved_since_arming_is_not_preset(deg: float, result: Result) -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    desk.wait(200)
    desk.joints.change(1, model_deg=deg)
    assert desk.ask(Command.CONFIRM) is result


def test_standing_at_zero_is_no_movement() -> None:
    desk = Desk()
    desk.joints.change(1, model_deg=359.9999)
    desk.ask(Command.ARM_PRESET)
    desk.wait(200)
    desk.joints.change(1, model_deg=0.0001)
    assert desk.ask(Command.CONFIRM) is Result.DONE


@pytest.mark.parametrize("change", [{"valid": False}, {"model_deg": None}, {"binding": None}])
def test_a_joint_without_a_good_angle_gets_no_preset(change: dict[str, object]) -> None:
    desk = Desk()
    desk.joints.change(1, **change)
    assert desk.ask(Command.ARM_PRESET) is Result.NOT_VALID
    good = Desk()
    good.ask(Command.ARM_PRESET)
    good.wait(200)
    good.joints.change(1, **change)
    assert good.ask(Command.CONFIRM) is Result.NOT_VALID
    assert good.store.saved == []


def test_two_connections_do_not_confirm_each_others_preset() -> None:
    desk = Desk()
    other = desk.desk.session(replace(PLC, address="192.0.2.8"))
    desk.ask(Command.ARM_PRESET)
    desk.wait(200)
    assert desk.ask(Command.CONFIRM, session=other) is Result.NOT_ARMED
    assert desk.ask(Command.ARM_PRESET, session=other) is Result.ARMED
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED
    desk.wait(200)
    assert desk.ask(Command.CONFIRM, session=other) is Result.DONE


def test_a_connection_that_ends_takes_what_it_armed_with_it() -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    desk.session.close()
    desk.wait(200)
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED


def test_cancelling_disarms() -> None:
    desk = Desk()
    desk.ask(Command.ARM_PRESET)
    assert desk.ask(Command.CANCEL) is Result.DONE
    desk.wait(200)
    assert desk.ask(Command.CONFIRM) is Result.NOT_ARMED


def test_a_preset_is_in_force_only_when_it_is_on_the_disk() -> None:
    desk = Desk()
    desk.store.slow = True
    assert desk.preset() is Result.PENDING
    assert desk.joints.zeros[1] == 0
    assert desk.session.registers(desk.now_ns)[4] == Result.PENDING
    desk.ask(Command.ARM_PRESET, 2)
    desk.wait(200)
    assert desk.ask(Command.CONFIRM, 2) is Result.BUSY
    desk.store.waiting.pop()(True)
    assert desk.joints.zeros[1] == 100 * 3_600_000
    assert desk.ask(Command.CONFIRM, 2) is Result.PENDING


def test_a_preset_that_cannot_be_stored_is_not_in_force() -> None:
    desk = Desk()
    desk.store.works = False
    assert desk.preset() is Result.STORAGE_FAILED
    assert desk.joints.zeros[1] == 0
    assert not desk.desk.presets


def test_an_encoder_exchanged_while_the_disk_was_busy_does_not_get_the_preset() -> None:
    desk = Desk()
    desk.store.slow = True
    desk.preset()
    desk.joints.change(1, binding=replace(BINDING, serial_number=1))
    desk.store.waiting.pop()(True)
    assert desk.joints.zeros[1] is None


def test_a_stored_preset_applies_to_its_own_encoder_and_model() -> None:
    desk = Desk(STORED)
    assert desk.joints.zeros == {1: 360_000, 2: 0}
    assert desk.reports[0].event == "preset_applied"


@pytest.mark.parametrize(
    "found",
    [
        replace(BINDING, serial_number=4712),
        replace(BINDING, model_sha256="cd" * 32),
        replace(BINDING, serial_number=None),
        replace(BINDING, preset_value=1),
    ],
)
def test_a_stored_preset_is_not_applied_to_another_encoder_or_model(found: object) -> None:
    desk = Desk()
    desk.joints.change(1, binding=None)
    again = CommandDesk(desk.joints, desk.store, presets=[STORED], report=desk.reports.append)
    # Until the node is identified nobody knows whose zero it is.
    assert desk.joints.zeros[1] is None
    again.identified(1, found)  # pyright: ignore[reportArgumentType]
    assert desk.joints.zeros[1] is None
    assert desk.reports[-1].event == "preset_of_other_encoder"
    again.identified(1, BINDING)
    assert desk.joints.zeros[1] == 360_000


def test_a_preset_is_removed_in_two_steps_as_well() -> None:
    desk = Desk(STORED)
    assert desk.ask(Command.ARM_REMOVAL) is Result.ARMED
    assert desk.joints.zeros[1] == 360_000
    desk.wait(200)
    assert desk.ask(Command.CONFIRM) is Result.DONE
    assert (desk.joints.zeros[1], desk.store.saved) == (0, [()])


def test_a_moving_valid_joint_keeps_its_preset_and_one_that_serves_nothing_can_lose_it() -> None:
    desk = Desk(STORED)
    desk.joints.change(1, velocity_deg_s=5.0)
    assert desk.ask(Command.ARM_REMOVAL) is Result.MOVING
    desk.joints.change(1, valid=False, model_deg=None, velocity_deg_s=None)
    assert desk.ask(Command.ARM_REMOVAL) is Result.ARMED
    desk.wait(200)
    assert desk.ask(Command.CONFIRM) is Result.DONE


def test_faults_are_cleared_and_reference_angles_noted() -> None:
    desk = Desk()
    assert desk.ask(Command.CLEAR_FAULT, 2) is Result.DONE
    assert desk.ask(Command.REFERENCE_ANGLE, 1, 3_600_000) is Result.DONE
    assert desk.joints.cleared == [2]
    assert desk.joints.references == [(1, 1.0, "192.0.2.7")]
    desk.joints.change(1, velocity_deg_s=1.0)
    assert desk.ask(Command.REFERENCE_ANGLE, 1, 0) is Result.MOVING


@pytest.mark.parametrize(
    ("command", "slot", "angle_mas", "result"),
    [
        (7, 1, 0, Result.UNKNOWN_COMMAND),
        (65535, 1, 0, Result.UNKNOWN_COMMAND),
        (1, 3, 0, Result.NO_JOINT),
        (1, 0, 0, Result.NO_JOINT),
        (1, 1, TURN_MAS, Result.ANGLE_RANGE),
        (1, 1, 0xFFFF_FFFF, Result.ANGLE_RANGE),
    ],
)
def test_what_makes_no_sense_is_refused(command: int, slot: int, angle_mas: int, result: Result) -> None:
    assert Desk().ask(command, slot, angle_mas) is result


def test_every_command_is_reported_with_peer_and_role() -> None:
    desk = Desk()
    desk.preset(1, 5)
    told = [(one.event, one.slot, one.result, one.peer.address, one.peer.role) for one in desk.reports]
    assert ("arm_preset", 1, Result.ARMED, "192.0.2.7", "setter") in told
    assert ("preset_stored", 1, Result.DONE, "192.0.2.7", "setter") in told
    assert ("confirm", 1, Result.DONE, "192.0.2.7", "setter") in told


def test_a_plc_that_asks_in_every_cycle_does_not_fill_the_log() -> None:
    desk = Desk()
    desk.joints.change(1, velocity_deg_s=3.0)
    for _ in range(100):
        assert desk.ask(Command.ARM_PRESET) is Result.MOVING
    desk.joints.change(1, velocity_deg_s=0.0)
    desk.ask(Command.ARM_PRESET)
    while desk.ask(Command.CONFIRM) is Result.TOO_EARLY:
        desk.wait(1)
    told = [(one.event, one.result) for one in desk.reports]
    assert told == [
        ("arm_preset", Result.MOVING),
        ("arm_preset", Result.ARMED),
        ("preset_stored", Result.DONE),
        ("confirm", Result.DONE),
    ]


def test_the_block_shows_what_this_connection_wrote_armed_and_got() -> None:
    desk = Desk()
    assert desk.session.registers(desk.now_ns) == (0, 0, 0, 0, 0, 0, 0, 0)
    assert desk.session.write(0, (2, 0x0001, 0x0002), desk.now_ns) is Result.NONE
    assert desk.session.write(3, (Command.ARM_PRESET,), desk.now_ns) is Result.ARMED
    desk.wait(1500)
    assert desk.session.registers(desk.now_ns) == (2, 1, 2, 0, Result.ARMED, 2, 3500, 1)
    desk.wait(4000)
    assert desk.session.registers(desk.now_ns) == (2, 1, 2, 0, Result.ARMED, 0, 0, 1)


def test_every_command_and_result_has_its_meaning_and_numbers_stay() -> None:
    assert set(COMMAND_MEANING) == set(Command)
    assert set(RESULT_MEANING) == set(Result)
    assert {command.name: int(command) for command in Command} == {
        "ARM_PRESET": 1,
        "CONFIRM": 2,
        "ARM_REMOVAL": 3,
        "CANCEL": 4,
        "CLEAR_FAULT": 5,
        "REFERENCE_ANGLE": 6,
    }
    assert {int(result) for result in GOOD_RESULTS} == {0, 1, 2, 3}
    assert [int(result) for result in Result] == [0, 1, 2, 3, *range(10, 21)]


@given(
    steps=st.lists(
        st.tuples(
            st.integers(0, 8),
            st.integers(0, 3),
            st.sampled_from([0, 1, TURN_MAS - 1, TURN_MAS, 0xFFFF_FFFF]),
            st.sampled_from([0.0, 99.0, 100.0, 4999.0, 5001.0]),
            st.booleans(),
        ),
        max_size=25,
    )
)
def test_no_order_of_commands_moves_a_zero_that_was_not_armed_and_confirmed_in_time(
    steps: list[tuple[int, int, int, float, bool]],
) -> None:
    desk = Desk()
    other = desk.desk.session(replace(PLC, address="192.0.2.8"))
    armed: dict[CommandSession, tuple[int, int, int]] = {}
    for command, slot, angle_mas, pause_ms, second in steps:
        desk.wait(pause_ms)
        session = other if second else desk.session
        saved = len(desk.store.saved)
        result = desk.ask(command, slot, angle_mas, session)
        if len(desk.store.saved) > saved:
            assert command == Command.CONFIRM
            armed_slot, armed_mas, armed_ns = armed.pop(session)
            assert (armed_slot, armed_mas) == (slot, angle_mas)
            assert 100 * MS <= desk.now_ns - armed_ns <= 5000 * MS
        if result is Result.ARMED:
            armed[session] = (slot, angle_mas, desk.now_ns)
