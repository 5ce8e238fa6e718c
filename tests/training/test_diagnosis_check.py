"""The scorer of the diagnosis check: figures on answers made by hand, a file that a second call goes on with."""

import json
from dataclasses import replace
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rich.console import Console
from tests.benchmarks.diagnosis_check import run as runner
from tests.benchmarks.diagnosis_check.answers import Answer, Ask, ask_attribution, ask_report, library_for
from tests.benchmarks.diagnosis_check.case_set import SHORT, Sizes, wishes
from tests.benchmarks.diagnosis_check.figures import settled, share, table
from tests.benchmarks.diagnosis_check.intervals import calibration_error, exact_binomial
from tests.benchmarks.diagnosis_check.marks import band, marks_of
from tests.benchmarks.diagnosis_check.summary import document, markdown

from trueangle_training.plant.cases import draw_case
from trueangle_training.plant.defect import CellTruth
from trueangle_training.plant.wish import Wish
from trueangle_training.plant.truth import EffectTruth, Truth

Json = dict[str, Any]


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
    return Answer(report=report, visible={}, true_closure=0.95, seconds=0.1)


def cause(name: str, *others: str, probability: float = 0.95) -> Json:
    return {
        "effect": name,
        "probability": probability if not others else 0.5,
        "class": [name, *others],
        "class_probability": probability,
    }


def marked(said: Answer, *effects: EffectTruth, stratum: str = "single", fault: str | None = None) -> Json:
    wish = Wish(seed=1, plan="paper", stratum="single")
    return marks_of(wish, truth(*effects, stratum=stratum, fault=fault), said)


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
    elsewhere = marked(answer("named", cause("thermal_lag")), *two, stratum="confounded")
    assert not elsewhere["confounded_met"]
    assert elsewhere["confident_wrong"]


def test_a_cell_counts_among_the_first_two_only() -> None:
    def place(order: str) -> Json:
        rest = {"direction": "even", "time": "constant", "speed": "constant", "load": "constant"}
        cell = {"order": order, "temperature": "constant", "frame": "encoder", "moment": "mean", **rest}
        return {"cell": cell, "share": 0.3}

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


def test_the_case_set_has_all_strata_in_its_sizes_and_every_effect() -> None:
    sizes = Sizes()
    assert sum((sizes.noise, sizes.parametric, sizes.single, sizes.pair, sizes.confounded, sizes.unknown)) >= 800
    found = wishes(sizes, plan="paper", seed=1)
    assert sum(wish.stratum == "noise" for wish in found) == 400
    assert len({wish.seed for wish in found}) == len(found)
    assert len({wish.names[0] for wish in found if wish.stratum == "single"}) == 23
    assert len({wish.names[0] for wish in found if wish.stratum == "unknown"}) >= 10
    assert found == wishes(sizes, plan="paper", seed=1)
    assert found != wishes(sizes, plan="paper", seed=2)


def test_the_table_counts_what_was_marked_and_says_what_it_missed() -> None:
    wrong = marked(answer("named", cause("windup")), stratum="noise")
    silent = marked(answer("none"), stratum="noise")
    figures = {figure.name: figure for figure in table([wrong, silent, silent, silent])}
    alarm = figures["false alarm, noise only"]
    assert (alarm.hits, alarm.cases, alarm.reached) == (1, 4, "MISSED")
    assert figures["unknown misnamed"].reached == "-"
    assert share("unknown misnamed", [silent], lambda record: record["misnamed"]).reached == "ambitious"


def test_every_failure_is_listed_with_its_wish() -> None:
    wrong = {**marked(answer("named", cause("windup")), stratum="noise"), "wish": "the wish", "way": "attribution"}
    whole = document([wrong], {"seed": 1})
    assert [failure["wish"] for failure in whole["failures"]] == ["the wish"]
    text = markdown(whole)
    assert "false alarm, noise only | <= 0.03" in text
    assert "`a` noise: nothing -> named: windup 0.95" in text
    json.dumps(whole)


def test_a_second_call_goes_on_where_the_first_was_cut_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []

    def diagnose_one(wish: Wish, way: str) -> Json:
        asked.append(wish.seed)
        return {"wish": runner.key_of(wish), "way": way, "seed": wish.seed}

    monkeypatch.setattr(runner, "diagnose_one", diagnose_one)
    chosen = wishes(replace(SHORT, noise=4), plan="paper", seed=1)[:5]
    path, console = tmp_path / "attribution.jsonl", Console(file=StringIO())
    runner.run(chosen[:3], way="attribution", processes=1, path=path, console=console)
    whole = path.read_text("utf-8")
    path.write_text(whole[:-20], "utf-8")
    found = runner.run(chosen, way="attribution", processes=1, path=path, console=console)
    assert asked == [wish.seed for wish in (*chosen[:3], *chosen[2:])]
    assert [record["seed"] for record in found] == [wish.seed for wish in chosen]
    runner.run(chosen, way="attribution", processes=1, path=path, console=console)
    assert len(asked) == 6


@pytest.mark.parametrize("ask", [ask_attribution, ask_report])
def test_the_diagnosis_is_asked_and_marked(ask: Ask) -> None:
    wish = Wish(seed=11, plan="paper", stratum="single", names=("thermal_tilt",), enr=5.0)
    case = draw_case(wish)
    marks = marks_of(wish, case.truth, ask(case))
    assert marks["verdict"] in ("named", "unknown", "data_fault")
    assert marks["names"] == ["thermal_tilt"]
    json.dumps(marks)


def test_a_withheld_effect_is_not_in_the_library_that_is_asked() -> None:
    wish = Wish(seed=11, plan="paper", stratum="withheld", names=("thermal_tilt",))
    case = draw_case(wish)
    assert "thermal_tilt" not in library_for(case)
    assert "thermal_tilt" in library_for(draw_case(replace(wish, stratum="single")))
