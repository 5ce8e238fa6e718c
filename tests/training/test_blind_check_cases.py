"""Which cases a blind check asks for."""

from dataclasses import replace

import pytest

from trueangle_training.blind_check.case_set import (
    ENRS,
    FULL,
    HIDDEN_ON_PAPER,
    PlanChoice,
    Sizes,
    effects_of,
    spares_of,
    wishes,
    withheld_wishes,
)
from trueangle_training.plant.plants import PLANTS
from trueangle_training.plant.wish import Wish


def test_the_case_set_has_all_strata_in_the_targets_sizes() -> None:
    found = wishes(FULL, plan="both", plants=tuple(PLANTS), seed=1)
    assert len(found) == FULL.total >= 3100
    counted = {name: sum(wish.stratum == name for wish in found) for name in FULL.by_name()}
    assert counted == FULL.by_name()
    assert {wish.plant for wish in found} == set(PLANTS)
    assert all(set(wish.names) <= set(PLANTS[wish.plant].library) for wish in found if wish.stratum == "pair")
    assert len({(wish.plant, wish.names) for wish in found if wish.stratum == "unknown"}) >= 10


def test_a_pair_that_cannot_be_has_spares_of_the_same_kind_and_others_have_none() -> None:
    pair = Wish(seed=7, plan="paper", stratum="pair", names=("windup", "thermal_lag"), enr=2.0, ratio=0.3)
    spares = spares_of(pair)
    assert spares == spares_of(pair)
    assert {(spare.enr, spare.ratio, spare.stratum) for spare in spares} == {(2.0, 0.3, "pair")}
    assert all(len(set(spare.names)) == 2 and not set(spare.names) & set(HIDDEN_ON_PAPER) for spare in spares)
    assert len({spare.names for spare in spares}) > 1
    assert spares_of(replace(pair, stratum="single")) == ()


@pytest.mark.parametrize("plan", ["paper", "rich", "both"])
def test_as_many_cases_are_wished_as_are_asked_for(plan: PlanChoice) -> None:
    assert len(wishes(FULL.scaled(97), plan=plan, plants=("B", "C"), seed=1)) == 97


def test_every_effect_is_judged_on_sixty_strong_cases_of_plans_that_show_it() -> None:
    found = wishes(FULL, plan="both", plants=tuple(PLANTS), seed=1)
    strong = [wish for wish in found if wish.stratum == "single" and wish.enr >= 1]
    for name in effects_of(tuple(PLANTS)):
        seen = [w for w in strong if w.names == (name,) and (w.plan == "rich" or name not in HIDDEN_ON_PAPER)]
        assert len(seen) >= 60, name
    assert {wish.enr for wish in found if wish.stratum == "single"} == set(ENRS)


def test_the_same_set_is_the_same_and_different_sets_share_no_case() -> None:
    small = FULL.scaled(200)
    found = wishes(small, plan="paper", plants=("A",), seed=1)
    assert found == wishes(small, plan="paper", plants=("A",), seed=1)
    seeds = {wish.seed for wish in found}
    assert len(seeds) == len(found) == 200
    for other in (
        wishes(small, plan="paper", plants=("A",), seed=2),
        wishes(FULL.scaled(201), plan="paper", plants=("A",), seed=1),
        wishes(small, plan="both", plants=("A",), seed=1),
        wishes(small, plan="paper", plants=tuple(PLANTS), seed=1),
    ):
        assert not seeds & {wish.seed for wish in other}


def test_sizes_keep_their_proportion_and_their_sum() -> None:
    for total in (1, 7, 40, 600, 5000):
        assert FULL.scaled(total).total == total
    assert FULL.scaled(FULL.total) == FULL
    paper, rich = FULL.split(0.3)
    assert paper.confounded == FULL.confounded
    assert rich.confounded == 0
    assert paper.total + rich.total == FULL.total
    assert Sizes().scaled(360).single == 200


def test_a_withheld_effect_comes_with_others_and_on_a_plan_that_shows_it() -> None:
    found = withheld_wishes("windup", 12, plan="both", plants=("A",), seed=1)
    assert [wish.names for wish in found[:9]] == [("windup",)] * 9
    assert {wish.enr for wish in found[:9]} == {1.0, 2.0, 5.0}
    assert all("windup" not in wish.names for wish in found[9:])
    assert {wish.plan for wish in found} == {"paper"}
    assert {wish.plan for wish in withheld_wishes("read_latency", 4, plan="both", plants=("A",), seed=1)} == {
        "rich"
    }
    assert withheld_wishes("read_latency", 4, plan="paper", plants=("A",), seed=1) == []


def test_sound_joints_list_as_few_effects_as_those_that_lack_one() -> None:
    found = wishes(FULL, plan="both", plants=("A",), seed=3)

    def share(name: str, stratum: str) -> float:
        chosen = [wish for wish in found if wish.stratum == stratum and wish.plan == "paper"]
        return sum(name in (*wish.names, *wish.unlisted) for wish in chosen) / len(chosen)

    # 280 noise cases of shares about .05: standard error .013; 4 of them.
    for name in ("eccentricity", "grating_tilt", "thermal_eccentricity", "thermal_tilt"):
        assert share(name, "single") > 0.03
        assert abs(share(name, "noise") - share(name, "single")) < 0.052
        assert abs(share(name, "unknown") - share(name, "single")) < 0.052


def test_decoys_of_a_withheld_effect_do_not_list_it_either() -> None:
    found = withheld_wishes("eccentricity", 8, plan="paper", plants=("A", "B"), seed=1)
    assert {wish.stratum for wish in found} == {"withheld", "single", "noise"}
    assert all("eccentricity" in (*wish.names, *wish.unlisted) for wish in found)
