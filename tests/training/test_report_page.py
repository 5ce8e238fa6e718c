"""The report as a page and as a command: complete, safe, made from files."""

import argparse
import datetime
import hashlib
import io
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import pytest
from tests.fakes.report_inputs import (
    FACES,
    made_campaign,
    made_inputs,
    made_sweep,
)

from trueangle.contract.errors import ContractError
from trueangle.contract.metadata import (
    FitErrors,
)
from trueangle_training import cli, report_command
from trueangle_training.command import Surroundings
from trueangle_training.hidden_node_sweep import sweep_json
from trueangle_training.report.compared import read_comparison
from trueangle_training.report.writing import report_page

EXAMPLES = Path(report_command.__file__).parent / "examples"


class Seen(HTMLParser):
    """Tags and addresses of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []
        self.without_words = 0
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [
            value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")
        ]
        self.without_words += tag == "img" and not dict(attrs).get("alt")


def test_the_sweep_is_shown_with_what_it_is() -> None:
    text = report_page(made_inputs(sweep=made_sweep()))
    assert "left out of the training one by one (10.0 °C, 30.0 °C)" in text
    assert "one training a point" in text
    assert '<td class="n">0.907</td>' in text
    assert "Hidden nodes" not in report_page(made_inputs())


def test_the_page_needs_nothing_beside_itself() -> None:
    sweep = made_sweep()
    text = report_page(made_inputs(sweep=sweep))
    seen = Seen(text)
    assert not {"script", "link", "iframe", "object", "embed", "base", "form"} & set(seen.tags)
    assert len(seen.addresses) == 9
    assert all(address.startswith("data:image/svg+xml;base64,") for address in seen.addresses)
    assert seen.without_words == 0
    assert "@import" not in text
    assert "url(" not in text
    assert text == report_page(made_inputs(sweep=sweep))


def test_text_from_files_is_escaped() -> None:
    evil = '<script>alert(1)</script>"><img src=x onerror=y>'
    inputs = made_inputs(made_campaign(source=evil))
    metadata = replace(
        inputs.metadata,
        joint=evil,
        method=evil,
        versions={evil: evil},
        notes=(evil,),
        calibration=replace(inputs.metadata.calibration, id=evil),
        reference=replace(inputs.metadata.reference, kind=evil, certificate_id=evil),
        errors=FitErrors(held_out_rmse_arcsec=1.0, held_out_kind=evil),
    )
    document = {"format": 1, "methods": [{"name": evil, "in_sample_rmse": 1.0}]}
    comparison = read_comparison(json.dumps(document).encode(), source=evil)
    text = report_page(replace(inputs, metadata=metadata, model_file=evil, comparison=comparison))
    assert "script" not in Seen(text).tags
    assert not any(address == "x" for address in Seen(text).addresses)
    assert text.count("&lt;script&gt;alert(1)") >= 10


def test_an_angle_only_campaign_is_reported_without_temperatures() -> None:
    inputs = made_inputs(replace(made_campaign(), temperature_c=None))
    metadata = replace(inputs.metadata, temperature_used=False)
    text = report_page(replace(inputs, metadata=metadata))
    assert "not measured" in text
    assert "the model ignores temperature" in text
    assert "What temperature adds" not in text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{", "expected a JSON document"),
        ('{"format": 2, "methods": []}', "format 1, found format 2"),
        ("[1]", "found list"),
        ('{"format": 1, "methods": [3]}', "expected a list of methods"),
    ],
)
def test_what_is_no_comparison_is_refused(text: str, expected: str) -> None:
    with pytest.raises(ContractError, match=expected):
        read_comparison(text.encode(), source="compare.json")


def test_a_sweep_of_a_comparison_is_shown_or_passed_over_as_a_whole() -> None:
    whole = {
        "linear": sweep_json(made_sweep()),
        "gap": {"points": [{"hidden_nodes": 3, "rmse": 1.0}, {"hidden_nodes": 4, "rmse": 1.0}]},
        "one": {"points": [{"hidden_nodes": 3, "rmse": 1.0, "standard_error": 0.1}]},
        "odd": {"points": 3},
        "worse": 4,
    }
    read = read_comparison(json.dumps({"format": 1, "methods": [], "hidden_nodes": whole}).encode(), source="c")
    assert read.sweeps == (made_sweep(),)
    assert read.sweep("linear") == made_sweep()
    assert read.sweep("gap") is None


def run_report(arguments: list[str]) -> str:
    parser = argparse.ArgumentParser()
    report_command.register(parser.add_subparsers())
    parsed = parser.parse_args(["report", *arguments])
    out = io.StringIO()
    assert parsed.run(parsed, Surroundings(today=datetime.date(2025, 6, 1), out=out, err=io.StringIO())) == 0
    return out.getvalue()


def test_from_files_to_a_report(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "linear", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model), "--calibrated", "2025-03-01"]) == 0
    assert str(page) in run_report([str(model), str(campaign), "--joint", joint, "-o", str(page)])
    text = page.read_text()
    assert "readings it was trained on" in text
    assert "483 in 21 runs" in text
    assert "Hidden nodes" not in text


def test_a_report_takes_the_sweep_of_a_comparison_of_its_campaign_and_else_makes_one(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "fe-bpnn", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model), "--report", str(page)]) == 0
    assert "Hidden nodes" not in page.read_text()
    run_report([str(model), str(campaign), "-o", str(page)])
    made = page.read_text()
    assert "Method fe-bpnn: one training a point, random starts; the model itself has 20." in made
    assert "30: " in made
    document = {
        "format": 1,
        "calibration": {"sha256": hashlib.sha256(campaign.read_bytes()).hexdigest()},
        "methods": [],
        "hidden_nodes": {"fe-bpnn": sweep_json(made_sweep("made before"))},
    }
    compare = tmp_path / "compare.json"
    compare.write_text(json.dumps(document))
    run_report([str(model), str(campaign), "--compare", str(compare), "-o", str(page)])
    assert "Method fe-bpnn: made before." in page.read_text()


def test_a_campaign_unfit_for_training_is_reported_without_a_sweep(tmp_path: Path) -> None:
    campaign, model, page = tmp_path / "c.csv", tmp_path / "elbow.onnx", tmp_path / "r.html"
    joint = str(EXAMPLES / "joint.yaml")
    simulate = ["simulate", "--joint", joint, "--plan", str(EXAMPLES / "plan.yaml"), "--seed", "1"]
    assert cli.main([*simulate, "-o", str(campaign)]) == 0
    train = ["train", str(campaign), "--method", "fe-gabpnn", "--joint", joint, "--held-out", "none"]
    assert cli.main([*train, "-o", str(model)]) == 0
    lines = campaign.read_text().splitlines(keepends=True)
    campaign.write_text("".join(lines[: 3 + 2 * FACES]))
    run_report([str(model), str(campaign), "-o", str(page)])
    assert "Hidden nodes" not in page.read_text()


def test_all_faulty_files_are_named_at_once(tmp_path: Path) -> None:
    (tmp_path / "m.onnx").write_bytes(b"no model")
    (tmp_path / "c.csv").write_text("angle_deg\n1\n")
    (tmp_path / "compare.json").write_text("[]")
    files = [str(tmp_path / "m.onnx"), str(tmp_path / "c.csv")]
    with pytest.raises(ContractError) as caught:
        run_report([*files, "--compare", str(tmp_path / "compare.json"), "-o", str(tmp_path / "no" / "r.html")])
    for place in ("m.onnx: expected an ONNX model file", "c.csv", "compare.json", "r.html"):
        assert place in str(caught.value)
