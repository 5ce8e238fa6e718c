"""`trueangle blind-check` from the command line: what it writes, in which order, and what it refuses."""

import hashlib
import json
from pathlib import Path

import pytest

from trueangle_training import cli
from trueangle_training.plant.plants import PLANTS

Output = pytest.CaptureFixture[str]
QUICK = ["--plant", "A", "--plan", "paper", "--quick", "--processes", "1", "--seed", "5"]


def check(folder: Path, *arguments: str) -> int:
    return cli.main(["blind-check", "-o", str(folder), *QUICK, *arguments])


@pytest.fixture(scope="module")
def done(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("blind") / "set"
    assert check(folder, "--cases", "4", "--no-reports", "--log", str(folder.parent / "looks.jsonl")) == 0
    return folder


def test_a_set_is_sealed_diagnosed_opened_and_scored(done: Path) -> None:
    result = json.loads((done / "result.json").read_text())
    manifest = (done / "truth" / "manifest.jsonl").read_bytes()
    assert result["seal"]["manifest_sha256"] == hashlib.sha256(manifest).hexdigest()
    assert result["seal"]["cases"] + result["seal"]["skipped"] == 4
    assert result["crashed"] == []
    records = [json.loads(line) for line in (done / "marks.jsonl").read_text().splitlines()]
    assert len(records) == result["seal"]["cases"]
    assert {row["name"] for row in result["figures"]} >= {"false alarm, noise only", "unknown misnamed"}
    # The truths were complete before the first answer was there.
    sealed_at = (done / "seal.json").stat().st_mtime_ns
    assert all(path.stat().st_mtime_ns > sealed_at for path in (done / "answers").rglob("*.json"))


def test_the_page_needs_nothing_beside_itself(done: Path) -> None:
    text = (done / "result.html").read_text()
    assert json.loads((done / "seal.json").read_text())["manifest_sha256"] in text
    assert 'src="http' not in text
    assert "<script" not in text
    assert "Plant A" in text


def test_a_second_call_answers_nothing_anew_and_adds_no_look(done: Path, capsys: Output) -> None:
    log = done.parent / "looks.jsonl"
    before = {path: path.stat().st_mtime_ns for path in (done / "answers").rglob("*.json")}
    assert check(done, "--cases", "4", "--no-reports", "--log", str(log)) == 0
    assert {path: path.stat().st_mtime_ns for path in (done / "answers").rglob("*.json")} == before
    assert len(log.read_text().splitlines()) == 1
    assert "by this very diagnosis" in capsys.readouterr().out


def test_the_hash_is_printed_before_anything_else(done: Path, capsys: Output) -> None:
    assert check(done, "--cases", "4", "--no-reports") == 0
    first = capsys.readouterr().out.splitlines()[0]
    assert first.startswith("sealed")
    assert json.loads((done / "seal.json").read_text())["manifest_sha256"] in first


def test_worse_than_an_earlier_look_is_exit_code_1(done: Path, tmp_path: Path, capsys: Output) -> None:
    look = json.loads((done.parent / "looks.jsonl").read_text())
    log = tmp_path / "looks.jsonl"
    log.write_text(json.dumps(look) + "\n")
    assert check(done, "--cases", "4", "--no-reports", "--no-worse-than", str(log)) == 0
    name = "data fault said of sound data"
    look["figures"][name] |= {"value": -0.1}
    log.write_text(json.dumps(look) + "\n")
    assert check(done, "--cases", "4", "--no-reports", "--no-worse-than", str(log)) == 1
    assert f"worse than before: {name}" in capsys.readouterr().err


def test_a_withheld_effect_is_asked_without_it_and_with_it(tmp_path: Path) -> None:
    assert check(tmp_path, "--withhold", "thermal_tilt", "--cases", "2") == 0
    result = json.loads((tmp_path / "result.json").read_text())
    row = result["by_withheld"]["thermal_tilt"]
    assert row["cases"] == row["back"] == 2
    assert row["misnamed"] == 0
    assert row["named_when_back"] == 2
    assert result["conditions"]["withhold"] == "thermal_tilt"
    pages = list((tmp_path / "reports").rglob("report.html"))
    assert len(pages) == len({case["report"] for case in (*result["worst"], *result["random"])})
    page = (tmp_path / "result.html").read_text()
    assert all(f'href="reports/{path.parent.name}/report.html"' in page for path in pages)


def test_every_fault_of_the_order_is_named_at_once(tmp_path: Path, capsys: Output) -> None:
    log = tmp_path / "looks.jsonl"
    log.write_text("{oops\n")
    assert check(tmp_path / "set", "--withhold", "phlogiston", "--log", str(log)) == 2
    said = capsys.readouterr().err
    assert "phlogiston" in said
    assert "line 1" in said
    assert not (tmp_path / "set" / "seal.json").exists()


def test_another_set_in_the_folder_is_refused(done: Path, capsys: Output) -> None:
    assert check(done, "--cases", "5") == 2
    assert "cases 4" in capsys.readouterr().err


def test_a_baseline_without_this_set_is_refused_before_any_work(tmp_path: Path, capsys: Output) -> None:
    log = tmp_path / "looks.jsonl"
    assert check(tmp_path / "set", "--cases", "3", "--no-worse-than", str(log)) == 2
    assert "a look at the set" in capsys.readouterr().err
    assert not (tmp_path / "set" / "seal.json").exists()


def test_every_plant_can_be_asked_for() -> None:
    assert set(PLANTS) == {"A", "B", "C"}
