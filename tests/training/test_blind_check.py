"""The scorer of the blind check: marks, figures and page on answers made by hand."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from trueangle_training.blind_check.answers import Answer, Question, answer_of, answer_of_plain
from trueangle_training.blind_check.closure import true_closure_of
from trueangle_training.blind_check.figures import (
    Status,
    inflation,
    placed_or_class,
    settled,
    share,
    table,
    withheld_table,
)
from trueangle_training.blind_check.intervals import calibration_error, exact_binomial
from trueangle_training.blind_check.marks import band, marks_of
from trueangle_training.blind_check.page import check_page
from trueangle_training.blind_check.result import badness, chosen_cases, failing_of, figures_of, shown_of
from trueangle_training.blind_check.seal import SealedCase, key_of
from trueangle_training.blind_check.shuffled import shuffled_score
from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.defect import CellTruth
from trueangle_training.plant.truth import EffectTruth, Truth
from trueangle_training.plant.wish import Wish

Json = dict[str, Any]

CELL = {
    "order": "1",
    "temperature": "constant",
    "direction": "even",
    "time": "constant",
    "speed": "constant",
    "load": "constant",
    "frame": "encoder",
    "moment": "mean",
}


def effect(name: str, *, in_library: bool = True, accepted: tuple[str, ...] | None = None) -> EffectTruth:
    return EffectTruth(
        name=name,
        in_library=in_library,
        kind="mean",
        enr=1.0,
        visible_fraction=0.9,
        visible=True,
        contained_in={},
        accepted_names=((name,) if in_library else ()) if accepted is None else accepted,
        cells=(CellTruth(order="1"),),
        parameters={},
        curve_arcsec=np.zeros(3),
    )


def truth(*effects: EffectTruth, stratum: str = "single", fault: str | None = None) -> Truth:
    return Truth(
        case_id="a",
        seed=1,
        plant="A",
        plan="paper",
        stratum=stratum,
        asked_enr=1.0,
        noise_arcsec=0.5,
        effects=effects,
        listed=(),
        data_fault=fault,
        expected="named",
        carried_together=("reference_artefact",) if len(effects) > 1 else (),
        structure_arcsec=np.zeros(3),
    )


def answer(verdict: str, *causes: Json, where: tuple[Json, ...] = (), faults: tuple[str, ...] = ()) -> Answer:
    report = {
        "verdict": verdict,
        "causes": list(causes),
        "where": list(where),
        "data_faults": [{"kind": kind} for kind in faults],
        "unexplained": {"significant": verdict == "unknown"},
    }
    return Answer(report=report, visible={}, explained_arcsec=None, seconds=0.1)


def cause(name: str, *others: str, probability: float = 0.95) -> Json:
    return {
        "effect": name,
        "probability": probability if not others else 0.5,
        "class": [name, *others],
        "class_probability": probability,
    }


def marked(said: Answer, *effects: EffectTruth, stratum: str = "single", fault: str | None = None) -> Json:
    wish = Wish(seed=1, plan="paper", stratum="single")
    marks = marks_of(wish, truth(*effects, stratum=stratum, fault=fault), said, true_closure=0.95)
    return {**marks, "wish": key_of(wish), "restored": False, "without": []}


def test_an_exact_interval_agrees_with_its_closed_forms() -> None:
    # No hit in n: 1 - alpha/2 ^ (1/n); the figures of the rule of three at n = 400.
    low, high = exact_binomial(0, 400)
    assert (low, high) == (0.0, pytest.approx(1.0 - 0.025 ** (1 / 400)))
    low, high = exact_binomial(10, 10)
    assert (low, high) == (pytest.approx(0.025 ** (1 / 10)), 1.0)
    # Clopper and Pearson for 11 of 400: the most false alarms that keep the upper bound below 5 %.
    assert exact_binomial(11, 400)[1] == pytest.approx(0.0487, abs=5e-4)


def test_calibration_error_is_the_distance_of_stated_and_right() -> None:
    rows = np.array([(0.95, 1.0)] * 8 + [(0.95, 0.0)] * 2 + [(0.35, 0.0)] * 10)
    assert calibration_error(rows) == pytest.approx(0.5 * 0.15 + 0.5 * 0.35)
    assert calibration_error(np.array([(1.0, 1.0)] * 5)) == pytest.approx(0.0)


def test_a_named_effect_is_right_by_its_class_and_wrong_by_confidence() -> None:
    windup = effect("windup")
    right = marked(answer("named", cause("windup")), windup)
    assert right["right_class"]
    assert right["exact"]
    assert not right["confident_wrong"]
    as_class = marked(answer("named", cause("index_drift", "windup")), windup)
    assert as_class["right_class"]
    assert not as_class["right_effect"]
    assert not as_class["confident_wrong"]
    wrong = marked(answer("named", cause("index_drift")), windup)
    assert not wrong["right_class"]
    assert wrong["confident_wrong"]
    assert wrong["misnamed"]
    shy = marked(answer("unknown", cause("index_drift", probability=0.6)), windup)
    assert not shy["confident_wrong"]
    assert shy["first_right"] is False


def test_an_extra_name_spoils_the_exact_set() -> None:
    both = answer("named", cause("windup"), cause("count_loss"))
    assert not marked(both, effect("windup"))["exact"]
    assert marked(both, effect("windup"))["extra"] == 1
    assert marked(both, effect("count_loss"), effect("windup"), stratum="pair")["exact"]


def test_an_unknown_is_caught_by_the_verdict_and_misnamed_by_a_name() -> None:
    family = effect("odd_run", in_library=False)
    assert marked(answer("unknown"), family, stratum="unknown")["caught"]
    named = marked(answer("named", cause("windup")), family, stratum="unknown")
    assert not named["caught"]
    assert named["misnamed"]
    assert named["confident_wrong"]
    alias = effect("odd_run", in_library=False, accepted=("windup",))
    assert not marked(answer("named", cause("windup")), alias, stratum="unknown")["misnamed"]


def test_of_a_withheld_effect_unknown_or_its_class_is_right_and_its_own_name_impossible() -> None:
    gone = effect("windup", accepted=("windup", "reference_artefact"))
    said = marked(answer("named", cause("reference_artefact", "bearing_wobble")), gone, stratum="withheld")
    assert settled(said)
    assert settled(marked(answer("unknown"), gone, stratum="withheld"))
    assert not settled(marked(answer("named", cause("thermal_lag")), gone, stratum="withheld"))
    assert not settled(marked(answer("none"), gone, stratum="withheld"))


def test_of_a_confounded_pair_a_class_is_right_and_one_confident_name_is_not() -> None:
    two = (
        effect("graduation_error"),
        effect("localized_defect", accepted=("localized_defect", "reference_artefact")),
    )
    as_class = answer("named", cause("reference_artefact", "graduation_error"))
    assert marked(as_class, *two, stratum="confounded")["confounded_ok"]
    assert marked(answer("unknown"), *two, stratum="confounded")["confounded_ok"]
    one_name = marked(answer("named", cause("reference_artefact")), *two, stratum="confounded")
    assert not one_name["confounded_ok"]
    assert one_name["confounded_met"]
    assert not one_name["confident_wrong"]
    both = marked(
        answer("named", cause("localized_defect"), cause("graduation_error")), *two, stratum="confounded"
    )
    assert both["confounded_ok"]
    elsewhere = marked(answer("named", cause("thermal_lag")), *two, stratum="confounded")
    assert not elsewhere["confounded_met"]
    assert elsewhere["confident_wrong"]


def test_a_cell_counts_among_the_first_two_only() -> None:
    def place(order: str) -> Json:
        return {"cell": {**CELL, "order": order}, "share": 0.3}

    second = answer("unknown", where=(place("4"), place("1")))
    third = answer("unknown", where=(place("4"), place("5"), place("1")))
    assert marked(second, effect("eccentricity"))["cell_hit"]
    assert not marked(third, effect("eccentricity"))["cell_hit"]


def test_a_fault_is_named_rightly_by_its_kind() -> None:
    rightly = marked(
        answer("data_fault", faults=("direction_swapped",)), stratum="broken", fault="direction_swapped"
    )
    assert rightly["fault_named"]
    assert rightly["fault_kind"]
    other = marked(answer("data_fault", faults=("outliers",)), stratum="broken", fault="direction_swapped")
    assert other["fault_named"]
    assert not other["fault_kind"]


def test_events_in_whole_counts_are_filed_under_the_nearest_ratio() -> None:
    assert [band(enr) for enr in (0.05, 0.3, 0.33, 1.3, 9.0)] == [0.2, 0.2, 0.5, 1.0, 5.0]


def test_the_table_counts_what_was_marked_and_says_what_it_missed() -> None:
    wrong = marked(answer("named", cause("windup")), stratum="noise")
    silent = marked(answer("none"), stratum="noise")
    figures = {figure.name: figure for figure in table([wrong, silent, silent, silent])}
    alarm = figures["false alarm, noise only"]
    assert (alarm.hits, alarm.cases) == (1, 4)
    assert alarm.must is Status.UNDECIDED
    assert figures["unknown misnamed"].must is Status.NOT_JUDGED


def test_a_bound_is_met_or_missed_by_the_whole_interval() -> None:
    def figure(hits: int, cases: int, name: str = "right class, ENR >= 0.5") -> Status:
        records = [{"hit": number < hits} for number in range(cases)]
        return share(name, records, lambda record: record["hit"]).must

    assert figure(990, 1000) is Status.MET
    assert figure(935, 1000) is Status.UNDECIDED
    assert figure(900, 1000) is Status.MISSED
    # The targets: false alarm <= 11 of 400, the upper bound of whose interval is 4.9 %.
    assert figure(11, 400, "false alarm, noise only") is Status.MET
    assert figure(12, 400, "false alarm, noise only") is Status.UNDECIDED
    assert figure(30, 400, "false alarm, noise only") is Status.MISSED


def test_a_calibration_error_of_few_cases_is_not_judged() -> None:
    records = [marked(answer("named", cause("windup", probability=0.7)), effect("windup"))] * 50
    found = {figure.name: figure for figure in table(records)}["calibration error, class"]
    assert found.value == pytest.approx(0.3)
    assert found.must is Status.UNDECIDED
    assert replace(found, cases=800).must is Status.MISSED


def test_inflation_is_the_difference_with_the_interval_of_newcombe() -> None:
    found = inflation((56, 70), (48, 80))
    # Newcombe 1998, table II (a): 56/70 - 48/80 = 0.2; with score intervals 0.0524 to 0.3339, exact ones wider.
    assert found.value == pytest.approx(0.2)
    assert found.low == pytest.approx(0.0524, abs=0.02)
    assert found.high == pytest.approx(0.3339, abs=0.02)
    assert inflation((0, 0), (1, 2)).must is Status.NOT_JUDGED


def test_a_withheld_effect_is_unknown_in_its_cell_and_named_when_it_is_back() -> None:
    place = {"cell": {**CELL, "order": "1"}, "share": 0.9}
    elsewhere = {"cell": {**CELL, "order": "7"}, "share": 0.9}
    gone = effect("windup")
    there = marked(answer("unknown", where=(place,)), gone, stratum="withheld")
    astray = marked(answer("unknown", where=(elsewhere,)), gone, stratum="withheld")
    back = {**marked(answer("named", cause("windup")), gone), "restored": True}
    assert placed_or_class(there)
    assert not placed_or_class(astray)
    rows = {figure.name: figure for figure in withheld_table([there, astray], [back, back])}
    assert rows["withheld, ENR >= 1: unknown in the right cell, or its class"].hits == 1
    assert rows["put back in the library: named"].hits == 2
    assert rows["put back in the library: true closure, median"].value == pytest.approx(0.95)


def test_the_worst_case_is_the_one_that_was_believed_and_wrong() -> None:
    windup = effect("windup")
    believed = {**marked(answer("named", cause("index_drift")), windup), "case_id": "believed"}
    silent = {**marked(answer("none"), windup), "case_id": "silent"}
    right = {
        **marked(answer("named", cause("windup"), where=({"cell": CELL, "share": 1.0},)), windup),
        "case_id": "r",
    }
    assert failing_of(believed)[0] == "a confident wrong name"
    assert failing_of(silent) == ("not found", "the wrong place")
    assert failing_of(right) == ()
    assert badness(right) == 0.0
    worst, random = chosen_cases([silent, right, believed], seed=1)
    assert [record["case_id"] for record in worst] == ["believed", "silent"]
    assert len(random) == 3


def test_the_page_shows_figures_failures_and_the_seal_and_escapes_what_it_is_given() -> None:
    wrong = {**marked(answer("named", cause("windup")), stratum="noise"), "case_id": "<b>"}
    rights = [
        marked(answer("named", cause("windup"), where=({"cell": CELL, "share": 1.0},)), effect("windup"))
    ] * 3
    text = check_page(result_of([wrong, *rights]))
    assert "false alarm, noise only" in text
    assert "&lt;b&gt;" in text
    assert "<b>" not in text
    assert "5ea1" in text
    assert "reports/" not in text
    assert "http" not in text.replace("http-equiv", "")


def result_of(records: list[Json]) -> Json:
    worst, random = chosen_cases(records, seed=1)
    return {
        "conditions": {
            "plant": "A",
            "plan": "paper",
            "seed": 1,
            "cases": len(records),
            "withhold": None,
            "quick": False,
        },
        "plants": {"A": "a plant"},
        "seal": {"manifest_sha256": "5ea1", "cases": len(records), "skipped": 0},
        "commit": None,
        "diagnosis_sha256": "d1a9",
        "diagnosis_changed": False,
        "on": "2026-01-31",
        "seen": {"before": 2, "same_diagnosis": False, "number": 3, "logged": True},
        "not_asked": [],
        "crashed": [],
        **figures_of(records),
        "canary": {
            "songs": [],
            "judged": False,
            "leaks": False,
            "control_tells": False,
            "shuffled": {"right": None},
        },
        "worst": [shown_of(record) for record in worst],
        "random": [shown_of(record) for record in random],
        "failures": [shown_of(record) for record in records if failing_of(record)],
        "reports": False,
        "reports_failed": {},
    }


def test_shuffled_truths_score_at_chance_and_a_scorer_that_does_not_look_is_found_out() -> None:
    names = ["windup", "index_drift", "count_loss", "thermal_lag"] * 10
    cases = [
        SealedCase(
            case_id=str(number),
            wish=Wish(seed=number, plan="paper", stratum="single"),
            truth=truth(effect(name)),
        )
        for number, name in enumerate(names)
    ]
    found = shuffled_score(cases, [answer("named", cause(name)) for name in names], seed=1)
    assert found["right"] == 1.0
    assert found["chance"] == pytest.approx(0.25)
    assert found["at_chance"]


@pytest.mark.parametrize("quick", [True, False])
def test_the_diagnosis_is_asked_and_marked(quick: bool) -> None:
    wish = Wish(seed=11, plan="paper", stratum="single", names=("thermal_tilt",), enr=5.0)
    case = draw_case(wish)
    question = Question(measured_csv=case.measured_csv, joint_yaml=case.joint_yaml, quick=quick)
    said = answer_of_plain(json.loads(json.dumps(answer_of(question).to_plain())))
    marks = marks_of(wish, case.truth, said)
    assert marks["verdict"] == "named"
    assert marks["right_class"]
    assert marks["names"] == ["thermal_tilt"]
    closure = true_closure_of(
        case.measured_csv,
        case.joint_yaml,
        truth_arcsec=case.truth.structure_arcsec,
        explained_arcsec=said.explained_arcsec,
    )
    assert closure is not None
    assert 0.9 < closure <= 1.0
    json.dumps(marks)


def test_a_withheld_effect_is_not_in_the_library_that_is_asked() -> None:
    case = draw_case(Wish(seed=11, plan="paper", stratum="withheld", names=("thermal_tilt",), enr=5.0))
    question = Question(measured_csv=case.measured_csv, joint_yaml=case.joint_yaml, quick=True)
    assert "thermal_tilt" in answer_of(question).visible
    without = answer_of(replace(question, without=("thermal_tilt",)))
    assert "thermal_tilt" not in without.visible
    assert "thermal_tilt" not in {name for each in without.report["causes"] for name in each["class"]}
