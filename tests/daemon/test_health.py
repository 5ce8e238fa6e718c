"""What speaks against an angle: each reason a bit of its own, and nothing else decides."""

import itertools
from dataclasses import replace
from typing import Any

import pytest

from trueangle.contract.metadata import Interval
from trueangle.core.health import (
    INFORMATION,
    SERVICE_MEANING,
    STATUS_MEANING,
    Evidence,
    Limits,
    NodeCondition,
    ServiceBit,
    StatusBit,
    judge,
)

LIMITS = Limits(
    stale_ms=50,
    temperature_stale_s=2,
    sensor_range_c=Interval(minimum=-55, maximum=125),
    model_angle_deg=Interval(minimum=0, maximum=300),
    model_temperature_c=Interval(minimum=10, maximum=40),
    max_uncertainty_arcsec=3.0,
)
GOOD = Evidence(
    bus_up=True,
    node=NodeCondition.RUNNING,
    age_ms=1.0,
    raw_deg=90.0,
    temperature_c=20.0,
    temperature_age_s=0.1,
    correction_arcsec=5.0,
    uncertainty_arcsec=2.0,
)
REASONS: list[tuple[dict[str, Any], StatusBit]] = [
    ({"bus_up": False}, StatusBit.BUS_DOWN),
    ({"node": NodeCondition.NOT_READY}, StatusBit.NODE_NOT_READY),
    ({"node": NodeCondition.SILENT}, StatusBit.NODE_NOT_READY),
    ({"node": NodeCondition.DIFFERS}, StatusBit.ENCODER_DIFFERS),
    ({"node": NodeCondition.FAULT}, StatusBit.NODE_FAULT),
    ({"node": NodeCondition.ID_CLASH}, StatusBit.NODE_ID_CLASH),
    ({"age_ms": 50.1}, StatusBit.STALE),
    ({"age_ms": None}, StatusBit.STALE),
    ({"temperature_age_s": 2.1}, StatusBit.TEMPERATURE_STALE),
    ({"temperature_age_s": None}, StatusBit.TEMPERATURE_STALE),
    ({"temperature_fault": True}, StatusBit.TEMPERATURE_BROKEN),
    ({"temperature_plausible": False}, StatusBit.TEMPERATURE_IMPLAUSIBLE),
    ({"temperature_c": 41.0}, StatusBit.TEMPERATURE_OUTSIDE_MODEL),
    ({"temperature_c": float("nan")}, StatusBit.TEMPERATURE_OUTSIDE_MODEL | StatusBit.TEMPERATURE_BROKEN),
    ({"raw_deg": 301.0}, StatusBit.ANGLE_OUTSIDE_MODEL),
    ({"correction_arcsec": float("nan")}, StatusBit.MODEL_REFUSED),
    ({"correction_arcsec": None}, StatusBit.MODEL_REFUSED),
    ({"correction_arcsec": -20_000.0}, StatusBit.MODEL_REFUSED),
    ({"uncertainty_arcsec": 3.1}, StatusBit.UNCERTAINTY_HIGH),
    ({"uncertainty_arcsec": float("nan")}, StatusBit.UNCERTAINTY_HIGH),
    ({"uncertainty_arcsec": None}, StatusBit.UNCERTAINTY_HIGH),
    ({"referenced": False}, StatusBit.NOT_REFERENCED),
    ({"jumped": True}, StatusBit.POSITION_JUMP),
    ({"past_due": True}, StatusBit.CALIBRATION_PAST_DUE),
    ({"sync_lost": True}, StatusBit.SYNC_LOST),
    ({"heads_disagree": True}, StatusBit.NODE_FAULT),
]


def test_a_joint_with_nothing_against_it_is_valid() -> None:
    assert judge(GOOD, LIMITS) == StatusBit.VALID | StatusBit.CONFIGURED


@pytest.mark.parametrize(("change", "bits"), REASONS)
def test_each_reason_sets_its_bit_and_clears_valid(change: dict[str, Any], bits: StatusBit) -> None:
    assert judge(replace(GOOD, **change), LIMITS) == bits | StatusBit.CONFIGURED


def test_reasons_add_up() -> None:
    for (one, bits), (other, more) in itertools.combinations(REASONS, 2):
        if not one.keys() & other.keys():
            assert judge(replace(GOOD, **one, **other), LIMITS) == bits | more | StatusBit.CONFIGURED


def test_without_a_limit_an_unknown_uncertainty_is_served_unless_something_is_known_to_have_enlarged_it() -> None:
    limits = replace(LIMITS, max_uncertainty_arcsec=None)
    unknown = replace(GOOD, uncertainty_arcsec=None)
    assert StatusBit.VALID in judge(unknown, limits)
    enlarged = judge(replace(unknown, uncertainty_needed=True), limits)
    assert enlarged == StatusBit.UNCERTAINTY_HIGH | StatusBit.CONFIGURED


def test_a_calibration_past_due_is_information_where_the_configuration_says_so() -> None:
    status = judge(replace(GOOD, past_due=True), replace(LIMITS, serve_past_due=True))
    assert status == StatusBit.VALID | StatusBit.CONFIGURED | StatusBit.CALIBRATION_PAST_DUE


def test_bits_keep_their_numbers_for_ever() -> None:
    assert {bit.name: bit.bit_length() - 1 for bit in StatusBit} == {
        "VALID": 0,
        "CONFIGURED": 1,
        "STALE": 2,
        "TEMPERATURE_STALE": 3,
        "TEMPERATURE_BROKEN": 4,
        "ANGLE_OUTSIDE_MODEL": 5,
        "TEMPERATURE_OUTSIDE_MODEL": 6,
        "MODEL_REFUSED": 7,
        "ENCODER_DIFFERS": 8,
        "NODE_NOT_READY": 9,
        "NODE_FAULT": 10,
        "BUS_DOWN": 11,
        "NOT_REFERENCED": 12,
        "POSITION_JUMP": 13,
        "UNCERTAINTY_HIGH": 14,
        "CALIBRATION_PAST_DUE": 15,
        "HELD": 16,
        "RAW_SERVED": 17,
        "LATENCY_COMPENSATED": 18,
        "HEAD_LOST": 19,
        "TEMPERATURE_IMPLAUSIBLE": 20,
        "NODE_ID_CLASH": 21,
        "USER_PRESET": 22,
        "SYNC_LOST": 23,
    }
    assert {bit.name: bit.bit_length() - 1 for bit in ServiceBit} == {
        "ALL_VALID": 0,
        "BUS_DOWN": 1,
        "FRAMES_DROPPED": 2,
        "BUS_DEGRADED": 3,
        "RECORDER_STOPPED": 4,
        "RELOAD_REFUSED": 5,
        "COMMANDS_ENABLED": 6,
    }


def test_every_bit_is_information_or_a_reason_that_some_evidence_sets() -> None:
    reasons = StatusBit(0)
    for _, bits in REASONS:
        reasons |= bits
    assert reasons | INFORMATION | StatusBit.VALID | StatusBit.CONFIGURED == ~StatusBit(0)
    assert not reasons & INFORMATION
    assert set(STATUS_MEANING) == set(StatusBit)
    assert set(SERVICE_MEANING) == set(ServiceBit)
