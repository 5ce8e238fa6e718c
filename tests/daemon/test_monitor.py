"""The live view: what an operator sees, on a real pseudo terminal, against a server made of bytes."""

import asyncio
import json
import re

import pytest
from tests.fakes.pseudo_terminal import PseudoTerminal
from tests.fakes.register_server import RegisterServer
from tests.fakes.register_values import joint_state
from tests.fakes.served_images import image_of
from tests.fakes.trueangled_process import command, environment, trueangled

from trueangle.core.health import ServiceBit, StatusBit
from trueangle.core.monitor_view import ASCII_SIGNS, UNICODE_SIGNS, MonitorState, Snapshot, render, sparkline
from trueangle.core.register_reading import SlotReading, read_group

STALE = joint_state(status=StatusBit.STALE | StatusBit.TEMPERATURE_STALE, corrected_deg=None)


def slots() -> tuple[SlotReading, ...]:
    data = image_of({slot: STALE if slot == 3 else None for slot in range(1, 7)}).read(0, 84)
    assert data is not None
    return read_group(data, 0).slots


def state(cycle: int = 1, now_s: float = 100.0) -> MonitorState:
    made = MonitorState(where="there", names={1: "base", 3: "elbow"}, since_s=now_s)
    made.took(Snapshot(slots=slots(), service=ServiceBit(0), cycle=cycle, heartbeat=cycle), now_s)
    return made


def screen(made: MonitorState, now_s: float, width: int = 80, height: int = 24, colour: bool = False) -> list[str]:
    return render(
        made, width=width, height=height, now_s=now_s, clock="22:00:00", colour=colour, signs=UNICODE_SIGNS
    )


@pytest.mark.parametrize(("width", "height"), [(80, 24), (132, 50), (100, 30), (40, 10), (20, 5)])
def test_the_view_fits_whatever_the_terminal_is(width: int, height: int) -> None:
    lines = screen(state(), 100.1, width, height)
    assert len(lines) <= height
    assert max(map(len, lines)) <= width


def test_80_by_24_shows_six_joints_their_curve_and_what_is_wrong() -> None:
    text = "\n".join(screen(state(), 100.1))
    assert "1 of 6 joints NOT VALID" in text
    assert re.search(r"1 base +✔ VALID +123\.456789 +123\.451234 +\+20\.00 +23\.46 +2\n", text)
    assert re.search(r"3 elbow +✖ STALE\+ +- +123\.451234", text)
    assert "3 elbow STALE: no position arrived within the configured limit" in text
    assert text.count("last minute [") == 6


def test_a_fault_is_a_word_and_a_sign_before_it_is_a_colour() -> None:
    plain, coloured = screen(state(), 100.1), screen(state(), 100.1, colour=True)
    assert [re.sub(r"\x1b\[[0-9;]*m", "", line) for line in coloured] == plain
    (line,) = (line for line in coloured if "elbow" in line and "raw" not in line and "123.45" in line)
    assert "\x1b[7m" in line  # reverse: a red lamp shows it too


def test_registers_that_stand_still_show_no_angle() -> None:
    made = state()
    made.took(Snapshot(slots=slots(), service=ServiceBit(0), cycle=1, heartbeat=1), 103.0)
    text = "\n".join(screen(made, 103.0))
    assert "REGISTERS STAND STILL for 3 s" in text
    assert "123.4" not in text


def test_a_lost_connection_takes_the_angles_with_it_and_says_for_how_long() -> None:
    made = state()
    made.lost("closed by the peer", 101.0)
    made.lost("refused", 104.0)
    text = "\n".join(screen(made, 113.0))
    assert "NO CONNECTION for 12 s: refused" in text
    assert "123.4" not in text
    made.took(Snapshot(slots=slots(), service=ServiceBit(0), cycle=9, heartbeat=1), 114.0)
    assert "lost 1 time" in "\n".join(screen(made, 114.1))


def test_joints_out_of_sight_are_counted_with_their_faults() -> None:
    footer = screen(state(), 100.1, height=12)[-1]
    assert re.search(r"↓ \d more below, 1 NOT VALID", footer)


def test_the_curve_of_the_last_minute_has_gaps_where_nothing_was_valid() -> None:
    points = [(100.0 - 60 + second, float(second)) for second in range(60) if not 20 <= second < 40]
    curve = sparkline(points, now_s=100.0, cells=6, signs="01234567")
    assert curve == "01  67"
    assert sparkline([(99.0, 5.0), (50.0, 5.0)], now_s=100.0, cells=6, signs=ASCII_SIGNS.spark).strip(" ") != ""


def test_monitor_lives_on_a_terminal_loses_and_regains_the_connection_and_gives_the_terminal_back() -> None:
    async def scenario() -> None:
        async with RegisterServer(image_of({1: None, 2: STALE})) as server:
            port = str(server.port)
            async with PseudoTerminal("monitor", "--port", port, "--every-ms", "50") as terminal:
                await terminal.until("1 of 2 joints NOT VALID")
                await server.stop()
                text = await terminal.until("NO CONNECTION")
                assert "123.4" not in text
                server.image = image_of({1: None, 2: None}, cycle=8)
                await server.start()
                await terminal.until("all 2 joints valid")
                terminal.size(132, 40)
                await terminal.until("last minute")
                terminal.keys("q")
                assert await terminal.ended() == 0
                assert terminal.settings() == terminal.before
                assert terminal.written.endswith(b"\x1b[?25h\x1b[?1049l")

    asyncio.run(scenario())


@pytest.mark.parametrize("key", ["\x03", "\x04", "Q"])
def test_ctrl_c_ends_it_as_q_does_even_without_a_server(key: str) -> None:
    async def scenario() -> None:
        async with PseudoTerminal("monitor", "--port", "1") as terminal:
            await terminal.until("NO CONNECTION")
            terminal.keys(key)
            assert await terminal.ended() == 0
            assert terminal.settings() == terminal.before

    asyncio.run(scenario())


def test_json_says_one_line_a_cycle_and_once_tells_by_its_exit_code() -> None:
    async def scenario(broken: bool) -> tuple[int, str]:
        async with RegisterServer(image_of({1: None, 8: STALE if broken else None})) as server:
            process = await asyncio.create_subprocess_exec(
                *command("monitor", "--port", str(server.port), "--json", "--once"),
                stdout=asyncio.subprocess.PIPE,
                env=environment(),
            )
            out, _ = await process.communicate()
            assert process.returncode is not None
            return process.returncode, out.decode()

    code, line = asyncio.run(scenario(broken=True))
    told = json.loads(line)
    assert (code, told["connected"], [j["valid"] for j in told["joints"]]) == (1, True, [True, False])
    assert told["joints"][1]["status"] == ["STALE", "TEMPERATURE_STALE"]
    assert told["joints"][1]["corrected_deg"] is None
    assert asyncio.run(scenario(broken=False))[0] == 0


def test_without_a_terminal_and_without_a_server_it_says_so_in_one_line() -> None:
    done = trueangled("monitor")
    assert done.returncode == 2
    assert "expected a terminal, or one of --json and --once" in done.stderr
    done = trueangled("monitor", "--once", "--port", "1")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("trueangled: 127.0.0.1:1 unit 1: cannot connect")
    done = trueangled("monitor", "--port", "70000")
    assert done.returncode == 2


COLOUR = re.compile(rb"\x1b\[[0-9;]*(3[0-7]|4[0-7])[0-9;]*m")


@pytest.mark.parametrize(
    ("variables", "coloured"),
    [({}, True), ({"NO_COLOR": "1"}, False), ({"NO_COLOR": ""}, True), ({"TERM": "dumb"}, False)],
)
def test_who_wants_no_colours_gets_none(variables: dict[str, str], coloured: bool) -> None:
    """no-color.org: any text but the empty one."""

    async def scenario() -> None:
        async with RegisterServer(image_of({1: None, 2: STALE})) as server:
            terminal = PseudoTerminal("monitor", "--port", str(server.port), variables=variables)
            async with terminal:
                await terminal.until("1 of 2 joints NOT VALID")
                assert bool(COLOUR.search(terminal.written)) is coloured

    asyncio.run(scenario())
