"""Joints that turn and warm up, sample by sample: each sample is a pure function of its number.

Two processes that build the same `LiveJoint` agree on every sample, noise included, without talking: the one shows
counts on a bus, the other knows the truth behind them.
"""

import hashlib
import math
import struct
from dataclasses import dataclass

from trueangle.contract.errors import ContractError, Fault
from trueangle.contract.units import ARCSEC_PER_DEG, DEG_PER_TURN
from trueangle_training.simulator.joint import SimulatedJoint

_TWO_UINT64 = struct.Struct("<QQ")
_SEED_AND_SEQUENCE = struct.Struct("<qq")
_HALF_STEP = 2.0**-54


@dataclass(frozen=True, slots=True, kw_only=True)
class Trajectory:
    """Constant speed, and a temperature that goes to and fro between two values."""

    start_deg: float
    """True angle at t = 0."""
    speed_deg_s: float
    start_c: float
    end_c: float
    ramp_s: float
    """Time from `start_c` to `end_c`, and as long back; above 0."""

    def __post_init__(self) -> None:
        if not self.ramp_s > 0:
            raise ContractError([Fault(where="ramp_s", expected="above 0 s", found=f"{self.ramp_s:g}")])

    def true_deg(self, time_s: float) -> float:
        """True angle, whole turns kept."""
        return self.start_deg + self.speed_deg_s * time_s

    def temperature_c(self, time_s: float) -> float:
        """Temperature on the triangle between `start_c` (at t = 0) and `end_c`, never outside."""
        phase = math.fmod(abs(time_s), 2 * self.ramp_s) / self.ramp_s
        share = phase if phase <= 1.0 else 2.0 - phase
        return self.start_c * (1.0 - share) + self.end_c * share


@dataclass(frozen=True, slots=True, kw_only=True)
class Truth:
    """Where the joint really is."""

    true_deg: float
    """Whole turns kept."""
    temperature_c: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSample:
    """What the joint's node puts on the bus."""

    counts: int
    """Position value in measuring units, 0 .. counts_per_rev - 1."""
    temperature_centi_c: int
    """As the temperature sensor shows it, in 0.01 degC."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveJoint:
    """A simulated joint on a trajectory, sampled at a fixed period."""

    simulated: SimulatedJoint
    trajectory: Trajectory
    sample_period_s: float
    seed: int
    """Of the noise, any 64-bit signed integer; joints of one bus take different ones."""

    def __post_init__(self) -> None:
        # The node's sample is a function of angle and temperature: what else an effect needs, it does not know.
        self.simulated.require_series()

    def truth(self, sequence: int) -> Truth:
        """The true state at sample number `sequence`."""
        time_s = sequence * self.sample_period_s
        return Truth(
            true_deg=self.trajectory.true_deg(time_s), temperature_c=self.trajectory.temperature_c(time_s)
        )

    def error_arcsec(self, sequence: int) -> float:
        """Noise-free error (indicated - true) at the sample."""
        truth = self.truth(sequence)
        return self.simulated.series.error_at_arcsec(truth.true_deg, truth.temperature_c)

    def sample(self, sequence: int) -> NodeSample:
        """What the node sends, noise, quantisation and sensor resolution included."""
        truth = self.truth(sequence)
        joint = self.simulated.joint
        error_arcsec = self.simulated.series.error_at_arcsec(truth.true_deg, truth.temperature_c)
        error_arcsec += joint.noise.repeatability_arcsec * standard_normal(self.seed, sequence)
        counts_per_rev = joint.encoder.counts_per_rev
        indicated_deg = math.fmod(truth.true_deg, DEG_PER_TURN) + error_arcsec / ARCSEC_PER_DEG
        shown_c = self.simulated.shown_temperature_c(truth.temperature_c)
        return NodeSample(
            counts=round(indicated_deg * counts_per_rev / DEG_PER_TURN) % counts_per_rev,
            temperature_centi_c=round(shown_c * 100),
        )


def standard_normal(seed: int, sequence: int) -> float:
    """One draw of N(0, 1) that belongs to `seed` and `sequence` alone (a keyed hash, then Box and Muller 1958).

    A generator's state would have to be carried from sample to sample; a hash of the number needs none.
    """
    digest = hashlib.blake2b(_SEED_AND_SEQUENCE.pack(seed, sequence), digest_size=16).digest()
    first, second = _TWO_UINT64.unpack(digest)
    # The upper 53 bits, centred in their steps: never 0, whose logarithm does not exist.
    radius = math.sqrt(-2.0 * math.log((first >> 11) * 2.0**-53 + _HALF_STEP))
    return radius * math.cos(2.0 * math.pi * (second >> 11) * 2.0**-53)
