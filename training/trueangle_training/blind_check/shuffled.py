"""The scorer on answers to other questions: right classes must be as rare as chance has them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from trueangle_training.blind_check.answers import Answer
from trueangle_training.blind_check.intervals import exact_binomial
from trueangle_training.blind_check.marks import CONFIDENT, marks_of
from trueangle_training.blind_check.seal import SealedCase

Json = dict[str, Any]

LEVEL = 0.99
LEAST = 10


def shuffled_score(cases: Sequence[SealedCase], answers: Sequence[Answer], *, seed: int) -> Json:
    """Truths dealt out anew among visible single effects, and scored as ever.

    Chance: over all pairs of an answer and a truth, how often the first named class holds the truth's name.
    """
    places = [
        i
        for i, case in enumerate(cases)
        if case.truth.stratum == "single" and case.truth.effects and case.truth.effects[0].visible
    ]
    if len(places) < LEAST:
        return {"cases": len(places), "right": None, "chance": None, "interval": None, "at_chance": None}
    order = np.random.default_rng([seed, 3]).permutation(len(places))
    hits = sum(
        marks_of(cases[places[j]].wish, cases[places[j]].truth, answers[i])["right_class"]
        for i, j in zip(places, order, strict=True)
    )
    true = sum(marks_of(cases[i].wish, cases[i].truth, answers[i])["right_class"] for i in places)
    names = [cases[i].truth.effects[0].name for i in places]
    chance = float(np.mean([_share_of(names, answers[i]) for i in places]))
    interval = exact_binomial(hits, len(places), level=LEVEL)
    return {
        "cases": len(places),
        "right": true / len(places),
        "shuffled": hits / len(places),
        "chance": chance,
        "interval": interval,
        "at_chance": interval[0] <= chance <= interval[1],
    }


def _share_of(names: Sequence[str], answer: Answer) -> float:
    named = [cause for cause in answer.report.get("causes", []) if cause["class_probability"] >= CONFIDENT]
    return sum(name in named[0]["class"] for name in names) / len(names) if named else 0.0
