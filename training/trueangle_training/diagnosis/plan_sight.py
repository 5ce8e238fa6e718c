"""The design check in the form of `design.json`."""

from collections.abc import Mapping

import numpy as np

from trueangle.contract.calibration import Campaign
from trueangle.contract.joint import Joint
from trueangle_training.diagnosis.design_check import Design
from trueangle_training.diagnosis.findings import Carried, PlanSight, Seen, Subject
from trueangle_training.diagnosis.location import FEWEST_RUNS
from trueangle_training.effects.effect import LibraryEffect, Nature

SMALLEST_LISTED = 0.01
"""A pair of which one can carry less of the other is not listed: a class begins at 0.95."""


def subject_of(campaign: Campaign, joint: Joint) -> Subject:
    """What is diagnosed, as both files name it."""
    return Subject(
        campaign=campaign.source,
        campaign_sha256=campaign.sha256,
        readings=len(campaign),
        runs=int(np.unique(campaign.run).size),
        joint=joint.name,
        modelled_effects=tuple(joint.effects),
    )


def plan_sight(
    design: Design,
    subject: Subject,
    library: Mapping[str, LibraryEffect],
    *,
    next_measurement: str,
    notes: tuple[str, ...],
) -> PlanSight:
    """What the plan can see, ready to be written; a blind plan asks for runs, whatever else it could do with."""
    # Of scatter alone nothing can be said without knowing the mean.
    testable = tuple(name for name in design.testable if library[name].nature is not Nature.VARIANCE)
    names = dict.fromkeys([*design.visible, *design.not_testable])
    return PlanSight(
        subject=subject,
        effects=tuple(
            Seen(effect=name, visible_fraction=design.visible.get(name), reason=design.reasons.get(name, ""))
            for name in names
        ),
        pairs=tuple(
            Carried(effect=name, by=other, fraction=fraction)
            for name, others in design.carries.items()
            for other, fraction in others.items()
            if fraction >= SMALLEST_LISTED
        ),
        testable=testable,
        invisible=design.invisible,
        not_testable={name: design.reasons.get(name, "") for name in design.not_testable},
        next_measurement=next_measurement if testable else _more_runs(subject),
        notes=notes,
    )


def _more_runs(subject: Subject) -> str:
    """What a plan needs before anything can be asked of it."""
    missing = max(1, FEWEST_RUNS - subject.runs)
    runs = "1 more run" if missing == 1 else f"{missing} more runs"
    return (
        f"Measure at least {runs} around the whole turn, at three temperatures or more, in both directions and "
        "with the polygon re-mounted. With 2 runs something can be held out, with "
        f"{FEWEST_RUNS} each pattern can be tested; until then re-calibrating the simulator's parameters takes up "
        "all that the readings show."
    )
