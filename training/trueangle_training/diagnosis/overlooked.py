"""Structure that no hypothesis was accepted for, although held-out runs and the map say that it is there.

An effect that shifts whole runs under one zero can pass for offsets that scatter from run to run: the evidence
then counts it as noise, while the scatter of repeats and the signs of whole runs tell that it is none.
"""

from collections.abc import Sequence

from trueangle_training.diagnosis.design_check import Design
from trueangle_training.diagnosis.findings import Place, Unexplained
from trueangle_training.diagnosis.problem import Problem
from trueangle_training.diagnosis.recalibration import recalibration_span
from trueangle_training.diagnosis.shares import Shares
from trueangle_training.effects.effect import Nature

OVERLOOKED = (
    "the evidence takes what stands out for offsets that scatter from run to run; held-out runs and the map say "
    "that it is none"
)


def more_than_noise(shares: Shares | None, places: Sequence[Place]) -> bool:
    """Whether held-out runs and the map together contradict the answer that all is noise."""
    if shares is None or not any(place.significant for place in places):
        return False
    return shares.structural_share > shares.floor_share


def overlooked(design: Design, cleaned: Problem) -> Unexplained:
    """What re-calibration leaves, as unexplained structure with the effect that could carry most of it."""
    carried = design.spans.carried(recalibration_span(cleaned).outside(cleaned.error_arcsec))
    shares: dict[str, float] = {}
    for shape, share in zip(cleaned.hypotheses, carried.tolist(), strict=True):
        if shape.effect is not None and shape.nature is Nature.MEAN:
            shares[shape.effect] = max(shares.get(shape.effect, 0.0), share)
    nearest = max(shares, key=lambda name: shares[name], default=None)
    share = 0.0 if nearest is None else min(shares[nearest], 1.0)
    return Unexplained(significant=True, nearest_effect=nearest, nearest_share=share)
