"""Reference angles against a model: each cause planted and found, and the null case left alone."""

import asyncio
import json
import math
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.fakes.pseudo_terminal import PseudoTerminal
from tests.fakes.register_server import RegisterServer
from tests.fakes.register_values import joint_state
from tests.fakes.running_service import COUNTS_PER_REV, MODELS, config_yaml, correction_arcsec, joint_yaml
from tests.fakes.served_images import image_of
from tests.fakes.trueangled_process import trueangled

from trueangle.core.verification import ReferencePoint, Verdict, combined_uncertainty, verify

U_ARCSEC = 0.5
ANGLES = [7.0 + 30 * i for i in range(12)]


def error(angle_deg: float) -> float:
    """What a joint's encoder does: 20 arcsec of eccentricity, 6 and 3 of higher orders."""
    t = math.radians(angle_deg)
    return 20 * math.cos(t) + 6 * math.cos(2 * t + 1) + 3 * math.sin(5 * t)


def points(
    wrong: Callable[[float], float], *, model: Callable[[float], float] = error, seed: int = 1, noise: float = 1.0
) -> list[ReferencePoint]:
    """Readings of an encoder that errs by `error + wrong`, corrected by a model that believes in `model`."""
    rng = np.random.default_rng(seed)
    made = []
    for reference in ANGLES:
        raw = reference + (error(reference) + wrong(reference) + rng.normal(0, noise * U_ARCSEC)) / 3600
        corrected = (raw - model(reference) / 3600) % 360
        made.append(
            ReferencePoint(
                reference_deg=reference, raw_deg=raw % 360, corrected_deg=corrected, uncertainty_arcsec=U_ARCSEC
            )
        )
    return made


def harmonic(order: int, arcsec: float) -> Callable[[float], float]:
    return lambda angle: arcsec * math.cos(order * math.radians(angle) + 0.3)


def other_joint(angle: float) -> float:
    t = math.radians(angle)
    return 18 * math.cos(3 * t + 2) + 9 * math.sin(2 * t) + 8 * math.cos(t + 3)


@pytest.mark.parametrize(
    ("wrong", "model", "verdict"),
    [
        (lambda _: 0.0, error, Verdict.GOOD),
        (lambda _: 40.0, error, Verdict.OFFSET),
        (lambda a: 40 + harmonic(1, 12)(a), error, Verdict.RESEATED),
        (harmonic(1, 12), error, Verdict.RESEATED),
        (lambda _: 0.0, other_joint, Verdict.WRONG_JOINT),
        (harmonic(3, 5), error, Verdict.CHANGED),
    ],
    ids=["null", "offset", "re-seated", "first harmonic", "wrong joint", "changed"],
)
def test_each_cause_is_told_by_its_pattern(
    wrong: Callable[[float], float], model: Callable[[float], float], verdict: Verdict
) -> None:
    assert verify(points(wrong, model=model), free_zero=False).verdict is verdict


def test_a_good_joint_is_called_bad_about_once_in_fifty() -> None:
    """0.01 by chi-squared and 12 * 0.0027 by single points: at most 4.2 %, so beyond 20 of 300 is no chance."""
    bad = sum(
        verify(points(lambda _: 0.0, seed=seed), free_zero=False).verdict is not Verdict.GOOD
        for seed in range(300)
    )
    assert 0 < bad <= 20


def test_an_own_zero_of_the_reference_says_nothing_and_a_harmonic_still_does() -> None:
    assert verify(points(lambda _: 4000.0), free_zero=True).verdict is Verdict.GOOD
    assert verify(points(lambda a: 4000 + harmonic(1, 12)(a)), free_zero=True).verdict is Verdict.RESEATED


def test_offset_harmonic_and_normalised_differences_are_those_of_the_closed_form() -> None:
    result = verify(points(lambda a: 7 + harmonic(1, 12)(a), noise=0.0), free_zero=False)
    assert result.offset_arcsec == pytest.approx(7, abs=1e-6)
    assert result.first_harmonic_arcsec == pytest.approx(12, abs=1e-6)
    assert result.normalised[0] == pytest.approx((7 + harmonic(1, 12)(ANGLES[0])) / (2 * U_ARCSEC), abs=1e-6)


def test_the_zero_crossing_is_no_difference() -> None:
    point = ReferencePoint(
        reference_deg=359.99999, raw_deg=0.0, corrected_deg=0.00001, uncertainty_arcsec=U_ARCSEC
    )
    result = verify([point], free_zero=False)
    assert result.differences_arcsec[0] == pytest.approx(0.072, abs=1e-6)
    assert result.verdict is Verdict.GOOD


def test_few_points_name_no_cause_that_they_cannot_show() -> None:
    few = points(harmonic(3, 30))[:4]
    assert verify(few, free_zero=False).verdict is Verdict.NOT_GOOD
    with pytest.raises(ValueError, match="expected at least 2"):
        verify(few[:1], free_zero=True)


def test_uncertainties_add_as_squares_and_none_at_all_is_none() -> None:
    assert combined_uncertainty(3.0, 4.0) == 5.0
    assert combined_uncertainty(None, 4.0) == 4.0
    assert combined_uncertainty(None, None) is None
    assert combined_uncertainty(0.0, None) is None


@pytest.fixture
def site(tmp_path: Path) -> Path:
    for name in ("good", "twin"):
        shutil.copy(MODELS / f"{name}.onnx", tmp_path)
    joints = joint_yaml(1, "base") + joint_yaml(2, "elbow", model="twin.onnx")
    (tmp_path / "c.yaml").write_text(config_yaml(joints), "utf-8")
    return tmp_path


def references(path: Path, wrong_arcsec: float) -> str:
    """Twelve readings of a joint that errs as good.onnx says, and by a constant more."""
    lines = ["reference_deg,angle_deg,temperature_c"]
    for number in range(12):
        counts = (number * COUNTS_PER_REV + 5000) // 12
        raw = counts * 360 / COUNTS_PER_REV
        reference = raw + (correction_arcsec(counts, 2200) - wrong_arcsec) / 3600
        lines.append(f"{reference:.9f},{raw:.9f},22.0")
    path.write_text("\n".join(lines) + "\n")
    return str(path)


def test_the_command_says_it_in_its_last_line_and_by_its_exit_code(site: Path) -> None:
    base = ("verify", "--config", str(site / "c.yaml"), "--joint", "base", "--reference-u", "1", "--reference")
    done = trueangled(*base, references(site / "good.csv", 0.0))
    assert (done.returncode, done.stdout.splitlines()[-1].split(":")[:2]) == (0, ["base", " good"]), done.stderr
    done = trueangled(*base, references(site / "off.csv", 60.0), "--json")
    told = json.loads(done.stdout)
    assert (done.returncode, told["verdict"]) == (1, "offset")
    assert told["offset_arcsec"] == pytest.approx(60, abs=0.01)


def test_bad_input_is_exit_2_and_one_line(site: Path) -> None:
    (site / "empty.csv").write_text("reference_deg,angle_deg,temperature_c\n")
    (site / "hot.csv").write_text("reference_deg,angle_deg,temperature_c\n1,1,99\n")
    for joint, reference, text in (
        ("wrist", "x.csv", "one of base, elbow"),
        ("base", "none.csv", "No such file"),
        ("base", str(site / "empty.csv"), "only a header"),
        ("base", str(site / "hot.csv"), "degC, as calibrated, found 99"),
        ("base", "interactive", "expected a terminal"),
    ):
        done = trueangled("verify", "--config", str(site / "c.yaml"), "--joint", joint, "--reference", reference)
        assert (done.returncode, done.stdout) == (2, ""), done.stderr
        (line,) = done.stderr.splitlines()
        assert text in line


def test_interactively_the_served_registers_are_read_and_a_moving_joint_is_not_taken(site: Path) -> None:
    async def scenario() -> None:
        still = joint_state(velocity_deg_s=0.0, corrected_deg=123.4567891 - 10)  # a user's zero of 10 deg
        async with (
            RegisterServer(image_of({1: joint_state()})) as server,
            PseudoTerminal(
                *("verify", "--config", str(site / "c.yaml"), "--joint", "base", "--reference", "interactive"),
                *("--port", str(server.port), "--free-zero"),
                columns=120,
            ) as terminal,
        ):
            await terminal.until("reference angle 1:")
            terminal.keys("123.4567891\n")
            await terminal.until("not taken: the joint moves (-45.500 deg/s)")
            server.image = image_of({1: still})
            for number in (1, 2):
                terminal.keys("123.4567891\n")
                await terminal.until(f"reference angle {number + 1}:")
            terminal.keys("\n")
            assert await terminal.ended() == 0
            await terminal.until("base: good")

    asyncio.run(scenario())
