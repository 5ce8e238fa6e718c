"""The seal, the workers that are told nothing, the log of looks, the canary."""

import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from trueangle.contract.errors import ContractError
from trueangle_training.blind_check import asking, looks, seal, workers
from trueangle_training.blind_check.answers import Json, Question
from trueangle_training.blind_check.asking import Round, ask_all
from trueangle_training.blind_check.canary import Song, Traits, song, traits_of
from trueangle_training.blind_check.frozen import diagnosis_sha256
from trueangle_training.blind_check.workers import Task, Worker, answers, bare_environment
from trueangle_training.plant.cases import Case, draw_case
from trueangle_training.plant.fitting import CaseNotFoundError
from trueangle_training.plant.truth import Truth
from trueangle_training.plant.wish import Wish

CONDITIONS = {"plant": "A", "plan": "paper", "seed": 1, "cases": 3, "withhold": None}
WISHES = [
    Wish(seed=1, plan="paper", stratum="noise"),
    Wish(seed=2, plan="paper", stratum="single", names=("thermal_tilt",), enr=5.0),
    Wish(seed=3, plan="paper", stratum="parametric"),
]


def made(
    folder: Path, wishes: Sequence[Wish] = WISHES, told: Callable[[int], None] = lambda done: None
) -> seal.Seal:
    return seal.sealed(folder, wishes, CONDITIONS, processes=1, told=told)


@pytest.fixture(scope="module")
def thermal_tilt() -> Case:
    return draw_case(WISHES[1])


def test_the_seal_is_the_hash_of_the_manifest_and_the_same_set_has_the_same(tmp_path: Path) -> None:
    one, other = made(tmp_path / "one"), made(tmp_path / "other")
    manifest = (tmp_path / "one" / "truth" / "manifest.jsonl").read_bytes()
    assert one == other
    assert hashlib.sha256(manifest).hexdigest() == one.manifest_sha256
    assert json.loads((tmp_path / "one" / "seal.json").read_text())["manifest_sha256"] == one.manifest_sha256
    assert [case.case_id for case in seal.opened(tmp_path / "one", one)] == list(one.case_ids)


def test_a_case_has_two_files_under_an_id_that_says_nothing(tmp_path: Path) -> None:
    found = made(tmp_path)
    folders = sorted((tmp_path / "cases").iterdir())
    assert [folder.name for folder in folders] == list(found.case_ids)
    assert {file.name for folder in folders for file in folder.iterdir()} == {"measured.csv", "joint.yaml"}
    assert all(len(case_id) == 16 and int(case_id, 16) >= 0 for case_id in found.case_ids)
    told = "".join((folder / name).read_text() for folder in folders for name in ("measured.csv", "joint.yaml"))
    assert "thermal_tilt:" not in (tmp_path / "cases" / _id_of(1) / "joint.yaml").read_text()
    assert not any(word in told for word in ("seed", "stratum", "truth", "enr"))


def _id_of(number: int) -> str:
    return seal.case_id_of(WISHES[number], CONDITIONS)


def test_truths_come_back_as_they_were_sealed(tmp_path: Path, thermal_tilt: Case) -> None:
    found = {case.wish.stratum: case for case in seal.opened(tmp_path, made(tmp_path))}
    truth = found["single"].truth
    assert found["single"].wish == WISHES[1]
    assert truth.effects[0].name == "thermal_tilt"
    assert truth.effects[0].cells == thermal_tilt.truth.effects[0].cells
    # Curves are written to 0.1 milliarcsecond.
    np.testing.assert_allclose(truth.structure_arcsec, thermal_tilt.truth.structure_arcsec, atol=6e-5)
    kept = asdict(replace(truth, effects=(), structure_arcsec=np.zeros(0)))
    first = asdict(replace(thermal_tilt.truth, case_id=truth.case_id, effects=(), structure_arcsec=np.zeros(0)))
    assert {name: value for name, value in kept.items() if name != "structure_arcsec"} == {
        name: value for name, value in first.items() if name != "structure_arcsec"
    }


@pytest.mark.parametrize("touched", ["truth/manifest.jsonl", "cases/{id}/measured.csv", "cases/{id}/joint.yaml"])
def test_what_was_touched_after_sealing_is_not_scored(tmp_path: Path, touched: str) -> None:
    found = made(tmp_path)
    path = tmp_path / touched.format(id=found.case_ids[0])
    path.write_text(path.read_text() + "\n")
    with pytest.raises(ContractError, match="sealed"):
        seal.opened(tmp_path, found)


def test_another_set_in_the_folder_is_refused_and_the_same_is_left_as_it_is(tmp_path: Path) -> None:
    found = made(tmp_path)
    assert made(tmp_path) == found
    with pytest.raises(ContractError, match="seed 1"):
        seal.sealed(tmp_path, WISHES, {**CONDITIONS, "seed": 2}, processes=1, told=lambda done: None)


def test_a_set_that_was_cut_off_is_finished_as_if_nothing_had_happened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = made(tmp_path / "whole")
    drawn: list[int] = []
    draw_one = seal.draw_one

    def draw(wish: Wish, case_id: str) -> tuple[Json, dict[str, str]]:
        if len(drawn) == 2:
            raise KeyboardInterrupt
        drawn.append(wish.seed)
        return draw_one(wish, case_id)

    monkeypatch.setattr(seal, "draw_one", draw)
    with pytest.raises(KeyboardInterrupt):
        made(tmp_path / "cut")
    part = tmp_path / "cut" / "truth" / "drawn.jsonl"
    part.write_text(part.read_text()[:-20])
    assert not (tmp_path / "cut" / "seal.json").exists()
    drawn.clear()
    assert made(tmp_path / "cut") == whole
    assert len(drawn) == 2


def test_a_wish_that_no_draw_fulfils_is_counted_and_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def draw(wish: Wish) -> Case:
        if wish.stratum == "parametric":
            raise CaseNotFoundError
        return draw_case(wish)

    monkeypatch.setattr(seal, "draw_case", draw)
    found = made(tmp_path)
    assert len(found.case_ids) == 2
    assert [json.loads(key)["stratum"] for key in found.skipped] == ["parametric"]


def test_a_worker_answers_as_the_diagnosis_does_and_knows_no_plant_and_no_path(thermal_tilt: Case) -> None:
    question = Question(measured_csv=thermal_tilt.measured_csv, joint_yaml=thermal_tilt.joint_yaml, quick=True)
    with Worker() as worker:
        said = worker.ask(question, pages_on=None)
        command = Path(f"/proc/{worker.pid}/cmdline").read_bytes().decode().split("\0")
        environment = Path(f"/proc/{worker.pid}/environ").read_bytes().decode().split("\0")
        folder = Path(f"/proc/{worker.pid}/cwd").readlink()
    assert said is not None
    assert said["report"]["verdict"] == "named"
    assert said["report"]["causes"][0]["effect"] == "thermal_tilt"
    assert command[1:] == ["-m", "trueangle_training.blind_check.worker", ""]
    allowed = {*bare_environment({}), *workers.KEPT, "LC_CTYPE"}
    assert {line.partition("=")[0] for line in environment if line} <= allowed
    assert "trueangle-worker-" in folder.name


def test_what_a_worker_imports_holds_nothing_of_the_plants() -> None:
    code = "import sys, trueangle_training.blind_check.worker; print(*sorted(sys.modules), sep='\\n')"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, env=bare_environment(os.environ)
    )
    modules = done.stdout.split()
    assert "trueangle_training.diagnosis.diagnose" in modules
    assert not [name for name in modules if name.startswith("trueangle_training.plant")]


def test_a_diagnosis_that_fails_is_an_answer_and_the_worker_goes_on(thermal_tilt: Case) -> None:
    good = Question(measured_csv=thermal_tilt.measured_csv, joint_yaml=thermal_tilt.joint_yaml, quick=True)
    bad = replace(good, joint_yaml="effects: [no_such_effect]\n")
    with Worker() as worker:
        failed, said = worker.ask(bad, pages_on=None), worker.ask(good, pages_on=None)
    assert failed is not None
    assert "no_such_effect" in failed["crashed"] or "ContractError" in failed["crashed"]
    assert said is not None
    assert "report" in said


class DyingWorker:
    """Answers its first question, dies over its second."""

    def __init__(self) -> None:
        self.asked = 0

    def ask(self, question: Question, *, pages_on: str | None) -> Json | None:
        self.asked += 1
        return {"said": question.joint_yaml} if self.asked == 1 else None

    def last_words(self) -> str:
        return "exit code -9"

    def kill(self) -> None: ...

    def close(self) -> None: ...


def test_a_worker_that_dies_costs_its_case_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "Worker", DyingWorker)
    tasks = [
        Task(key=str(number), ask=lambda number=number: Question(measured_csv="", joint_yaml=str(number)))
        for number in range(4)
    ]
    found = dict(answers(tasks, processes=1))
    assert found["0"] == {"said": "0"}
    assert "exit code -9" in found["1"]["crashed"]
    assert found["2"] == {"said": "2"}
    assert len(found) == 4


def test_a_fault_of_our_own_ends_the_check(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workers, "Worker", DyingWorker)

    def gone() -> Question:
        raise FileNotFoundError("measured.csv")

    with pytest.raises(FileNotFoundError):
        list(answers([Task(key="0", ask=gone)], processes=1))


def test_a_second_call_asks_only_what_is_missing_and_another_diagnosis_everything(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def stub(tasks: Sequence[Task], *, processes: int) -> Iterator[tuple[str, Json]]:
        for task in tasks[:2]:
            asked.append(task.key)
            yield task.key, {"report": {}}

    monkeypatch.setattr(asking, "answers", stub)
    case_ids = ("aa", "bb", "cc")
    own = Round(
        folder=tmp_path,
        seal=seal.Seal(manifest_sha256="", case_ids=case_ids, skipped=()),
        without=(),
        quick=False,
        diagnosis_sha256="1" * 64,
    )
    counts: list[tuple[int, int]] = []
    for _ in range(3):
        ask_all([own], processes=1, told=lambda done, total: counts.append((done, total)))
    assert asked == ["0/aa", "0/bb", "0/cc"]
    assert counts[-1] == (3, 3)
    ask_all([replace(own, diagnosis_sha256="2" * 64)], processes=1, told=lambda done, total: None)
    assert len(asked) == 5


def look(sha: str, **changed: Any) -> Json:
    return {"set": {**CONDITIONS, **changed}, "diagnosis_sha256": sha, "quick": False, "figures": {}}


def test_looks_count_states_of_the_diagnosis_and_not_repetitions(tmp_path: Path) -> None:
    path = tmp_path / "looks.jsonl"
    assert looks.looks_in(path) == []
    for sha in ("one", "one", "two"):
        looks.append(path, look(sha))
    looks.append(path, look("three", seed=7))
    kept = looks.looks_in(path)
    fresh = looks.seen_in(kept, CONDITIONS, diagnosis="new", quick=False)
    assert (fresh.before, fresh.same_diagnosis, fresh.number) == (2, False, 3)
    again = looks.seen_in(kept, CONDITIONS, diagnosis="two", quick=False)
    assert (again.before, again.same_diagnosis) == (1, True)
    assert not looks.seen_in(kept, CONDITIONS, diagnosis="two", quick=True).same_diagnosis
    assert looks.seen_in(kept, {**CONDITIONS, "plant": "B"}, diagnosis="new", quick=False).before == 0
    assert not looks.seen_in(None, CONDITIONS, diagnosis="new", quick=False).logged


def test_one_withheld_effect_among_all_was_seen_with_all() -> None:
    kept = [look("one", withhold="all", cases=240)]
    assert (
        looks.seen_in(kept, {**CONDITIONS, "withhold": "windup", "cases": 12}, diagnosis="new", quick=False).before
        == 1
    )
    assert looks.seen_in(kept, CONDITIONS, diagnosis="new", quick=False).before == 0


def test_a_broken_log_is_named_by_line(tmp_path: Path) -> None:
    path = tmp_path / "looks.jsonl"
    path.write_text(json.dumps(look("one")) + "\n{oops\n")
    with pytest.raises(ContractError, match="line 2"):
        looks.looks_in(path)


def test_one_case_less_is_worse_and_a_little_more_of_a_median_is_not() -> None:
    def figures(hits: int, alarms: int, median: float) -> Json:
        return {
            "figures": {
                "right": {"value": hits / 10, "hits": hits, "cases": 10, "at_most": False},
                "alarm": {"value": alarms / 10, "hits": alarms, "cases": 10, "at_most": True},
                "error": {"value": median, "hits": None, "cases": 10, "at_most": True},
            }
        }

    before = figures(9, 1, 0.02)
    assert looks.worse_than(figures(9, 1, 0.025), before, slack=0.01) == []
    assert looks.worse_than(figures(10, 0, 0.0), before, slack=0.01) == []
    assert looks.worse_than(figures(8, 1, 0.02), before, slack=0.01) == ["right: was 9 of 10, is 8 of 10"]
    assert len(looks.worse_than(figures(9, 2, 0.04), before, slack=0.01)) == 2
    assert looks.worse_than({"figures": {}}, before, slack=0.01)[0].startswith("right: was 0.9")


def test_the_state_of_the_diagnosis_is_the_same_from_call_to_call() -> None:
    assert diagnosis_sha256() == diagnosis_sha256()


def made_traits(rng: np.random.Generator, leak: float, label: bool) -> Traits:
    own = {name: float(rng.normal()) for name in ("one", "two", "three")}
    return Traits(file=own, plan={"hours": float(rng.normal()) + leak * label}, joint={}, errors={"scatter": 1.0})


def sung(leak: float, group: str) -> Song:
    rng = np.random.default_rng(3)
    label = rng.random(300) < 0.4
    stratum = (np.arange(300) % 2).astype(np.int64)
    traits = [made_traits(rng, leak, bool(each)) for each in label]
    return song("sound or not", group, traits, label, stratum)


def test_the_canary_sings_where_a_trait_tells_and_only_there() -> None:
    loud = sung(1.5, "all")
    assert loud.leaks
    # Two normals 1.5 apart: P(one above the other) = Phi(1.5 / sqrt 2) = 0.856.
    assert loud.area == pytest.approx(0.856, abs=0.05)
    assert loud.shuffled_area == pytest.approx(0.5, abs=0.02)
    assert sung(1.5, "plan").leaks
    assert not sung(1.5, "file").leaks
    assert not sung(0.0, "all").leaks


def test_the_canary_is_not_fooled_by_plans_that_differ() -> None:
    rng = np.random.default_rng(4)
    stratum = (np.arange(400) % 2).astype(np.int64)
    label = rng.random(400) < np.where(stratum == 1, 0.8, 0.2)
    traits = [
        Traits(file={}, plan={"rows": float(1000 * place + rng.normal())}, joint={}, errors={})
        for place in stratum
    ]
    assert not song("sound or not", "plan", traits, label, stratum).leaks


def test_too_few_cases_are_not_judged() -> None:
    rng = np.random.default_rng(5)
    traits = [made_traits(rng, 0.0, label=False) for _ in range(20)]
    found = song("sound or not", "all", traits, np.arange(20) < 3, np.zeros(20, dtype=np.int64))
    assert found.area is None
    assert not found.leaks


def test_traits_do_not_move_with_the_errors(thermal_tilt: Case) -> None:
    header, *rows = thermal_tilt.measured_csv.splitlines()
    louder = [row.split(",") for row in rows]
    for row in louder:
        row[1] = f"{100.0 * float(row[1]):.4f}" if row[1] else ""
    text = "\n".join([header, *(",".join(row) for row in louder)]) + "\n"
    before = traits_of(thermal_tilt.measured_csv, thermal_tilt.joint_yaml)
    after = traits_of(text, thermal_tilt.joint_yaml)
    assert before.of("all") == after.of("all")
    assert before.errors != after.errors
    assert before.file["rows"] == len(rows)


def test_a_truth_is_never_among_the_traits(thermal_tilt: Case) -> None:
    truth: Truth = thermal_tilt.truth
    names = set(traits_of(thermal_tilt.measured_csv, thermal_tilt.joint_yaml).of("all"))
    assert not names & {"seed", "stratum", *(effect.name for effect in truth.effects)}
