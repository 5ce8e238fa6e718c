"""From the configuration to how a joint is read, judged and served: mechanics, policy, limits, heads."""

import datetime
from dataclasses import replace

from trueangle.config import EncoderConfig, JointConfig, MotionConfig
from trueangle.contract.encoder import EncoderSettings
from trueangle.contract.metadata import CalibrationRecord
from trueangle.core.pipeline import HeadChannel, JointChannel
from trueangle.core.position import Mechanics, MotionLimits
from trueangle.core.serving import ServingPolicy, WhenNotValid
from trueangle.core.temperature_watch import TemperatureLimits
from trueangle.process_data import head_plans


def served_as_configured(
    channel: JointChannel, joint: JointConfig, calibration: CalibrationRecord
) -> JointChannel:
    """The channel with all that the joint's configuration says of serving."""
    temperature = joint.temperature
    scale = replace(
        channel.scale,
        mechanics=_mechanics(joint.encoder, joint.motion),
        temperature=TemperatureLimits(
            frozen_s=temperature.frozen_s, max_rate_c_per_s=temperature.max_rate_c_per_s
        ),
    )
    latency = joint.latency_compensation
    return replace(
        channel,
        scale=scale,
        limits=replace(
            channel.limits,
            max_uncertainty_arcsec=joint.max_uncertainty_arcsec,
            serve_past_due=joint.serve_past_due,
        ),
        policy=ServingPolicy(
            when_not_valid=WhenNotValid(joint.when_not_valid.policy.value),
            hold_ms=joint.when_not_valid.hold_ms or 0.0,
            latency_max_ms=None if latency is None else latency.max_ms,
        ),
        user_zero_deg=joint.zero_deg,
        further_heads=tuple(
            HeadChannel(
                plan=plan,
                scale=replace(
                    scale,
                    counts_per_rev=head.encoder.counts_per_rev,
                    mechanics=_mechanics(head.encoder, joint.motion),
                ),
                mounting_deg=head.mounting_deg,
            )
            for plan, head in zip(head_plans(joint), joint.further_heads, strict=True)
        ),
        max_head_difference_arcsec=joint.max_head_difference_arcsec,
        calibrated=datetime.date.fromisoformat(calibration.date),
        calibration_due=None if calibration.due is None else datetime.date.fromisoformat(calibration.due),
    )


def head_differences(joint: JointConfig, head: int, found: EncoderSettings) -> list[str]:
    """Why the angle of this further head must not be used; empty where it may."""
    return count_differences(joint.further_heads[head - 1].encoder, found) + found.differences_from(
        joint.further_heads[head - 1].encoder.settings
    )


def mechanics_text(joint: JointConfig) -> str:
    """How counts become the joint's angle, as configured; empty for one head, no gear, direction 1."""
    texts = [_encoder_text(joint.encoder)]
    texts += [
        f"head {head.node_id} at {head.mounting_deg:g} deg {_encoder_text(head.encoder)}".rstrip()
        for head in joint.further_heads
    ]
    return "; ".join(text for text in texts if text)


def _encoder_text(encoder: EncoderConfig) -> str:
    gear = encoder.gear_ratio
    parts = ["direction -1"] if encoder.direction == -1 else []
    if gear is not None and gear.motor_turns != gear.joint_turns:
        parts.append(f"gear {gear.motor_turns}:{gear.joint_turns}")
    return " ".join(parts)


def count_differences(encoder: EncoderConfig, found: EncoderSettings) -> list[str]:
    """What of the node's scaling is not as configured."""
    differences: list[str] = []
    if found.counts_per_rev != encoder.counts_per_rev:
        shown = "not readable" if found.counts_per_rev is None else str(found.counts_per_rev)
        differences.append(f"counts per revolution expected {encoder.counts_per_rev} found {shown}")
    range_units = found.total_range_units
    if range_units is not None and (range_units or 2**32) % encoder.counts_per_rev:
        # The position would wrap in the middle of a turn and show another angle from then on.
        differences.append(f"total_range_units {range_units} is no whole number of turns")
    return differences


def range_counts(found: EncoderSettings | None) -> int | None:
    """Where the node's counts start again at 0, as it told; 0 means 2^32 (CiA 406, 0x6002)."""
    if found is None or found.total_range_units is None:
        return None
    return found.total_range_units or 2**32


def _mechanics(encoder: EncoderConfig, motion: MotionConfig) -> Mechanics:
    gear = encoder.gear_ratio
    return Mechanics(
        direction=encoder.direction,
        motor_turns=1 if gear is None else gear.motor_turns,
        joint_turns=1 if gear is None else gear.joint_turns,
        range_counts=range_counts(encoder.settings),
        absolute=encoder.absolute,
        reference_mask=0 if encoder.reference is None else encoder.reference.mask,
        motion=MotionLimits(
            max_speed_deg_s=motion.max_speed_deg_s,
            margin_deg=motion.margin_deg,
            jitter_ms=motion.jitter_ms,
            settle_samples=motion.settle_samples,
        ),
    )
