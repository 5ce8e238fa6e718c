"""Reference angles on the standard input of `trueangled record` make its file a campaign."""

import asyncio
import subprocess
from pathlib import Path

import pytest
from tests.fakes.register_server import RegisterServer
from tests.fakes.register_values import joint_state
from tests.fakes.served_images import image_of
from tests.fakes.trueangled_process import command, environment

from trueangle.contract.calibration import read_campaign
from trueangle.contract.errors import ContractError
from trueangle.core.health import StatusBit
from trueangle.core.registers import JointState

STANDING = joint_state(velocity_deg_s=0.001)


def recorded(
    directory: Path, text: str, states: dict[int, JointState | None], *more: str, file: bool = False
) -> tuple[int, str, str]:
    """The command with this text on its standard input; exit code, stdout, stderr."""

    def run(port: int) -> subprocess.CompletedProcess[str]:
        arguments = ("--port", str(port), "--out", str(directory), "--every-ms", "10", "--references", *more)
        if file:
            path = directory / "input.txt"
            path.write_text(text, "utf-8")
            with path.open() as stream:
                return subprocess.run(
                    command("record", *arguments),
                    stdin=stream,
                    capture_output=True,
                    text=True,
                    check=False,
                    env=environment(),
                    timeout=60,
                )
        return subprocess.run(
            command("record", *arguments),
            input=text,
            capture_output=True,
            text=True,
            check=False,
            env=environment(),
            timeout=60,
        )

    async def scenario() -> tuple[int, str, str]:
        async with RegisterServer(image_of(states)) as server:
            done = await asyncio.to_thread(run, server.port)
            return done.returncode, done.stdout, done.stderr

    return asyncio.run(scenario())


def test_each_line_is_one_reading_with_its_error_and_the_end_of_input_ends_it(tmp_path: Path) -> None:
    code, out, err = recorded(tmp_path, "123.45\n\n-236.551\n123.4", {1: STANDING})
    assert (code, err) == (0, "")
    assert out.count("taken at 123.451234 deg raw") == 3
    (path,) = tmp_path.glob("*.csv")
    campaign = read_campaign(path.read_bytes(), source=path.name)
    # raw 123.4512345 deg, as the register image has it to the microdegree or better
    assert campaign.error_arcsec.tolist() == pytest.approx(
        [(123.4512345 - reference) * 3600 for reference in (123.45, 123.449, 123.4)], abs=0.01
    )


@pytest.mark.parametrize(
    ("text", "state", "reason"),
    [
        ("x\x1b[2J", STANDING, "reference x\\x1b[2J: not taken: expected an angle in degrees"),
        ("nan", STANDING, "not taken: expected an angle in degrees"),
        ("1", joint_state(), "not taken: the joint moves (-45.500 deg/s)"),
        ("1", joint_state(velocity_deg_s=None), "not taken: the joint's velocity is not known"),
        (
            "1",
            joint_state(velocity_deg_s=0.0, corrected_deg=None, status=StatusBit.STALE | StatusBit.CONFIGURED),
            "not taken: the joint has no position of now (STALE)",
        ),
    ],
)
def test_a_reference_that_fits_no_reading_is_not_taken_and_says_why(
    tmp_path: Path, text: str, state: JointState, reason: str
) -> None:
    code, out, _ = recorded(tmp_path, text + "\n", {1: state})
    assert code == 0
    assert reason in out
    (path,) = tmp_path.glob("*.csv")
    with pytest.raises(ContractError, match=r"found \d+ without angle or error; a recording has an error only"):
        read_campaign(path.read_bytes(), source=path.name)


def test_of_several_joints_one_must_be_named_and_a_file_is_no_moment(tmp_path: Path) -> None:
    code, _, err = recorded(tmp_path, "1\n", {1: STANDING, 2: STANDING})
    assert code == 2
    assert "--references: expected one joint: --slot N, found slot 1, slot 2" in err
    code, out, _ = recorded(tmp_path, "123.45\n", {1: STANDING, 2: STANDING}, "--slot", "2")
    assert code == 0
    assert "taken at" in out
    code, _, err = recorded(tmp_path, "1\n", {1: STANDING}, file=True)
    assert code == 2
    assert "--references: expected a terminal or a pipe on standard input, found a file" in err
