"""What is shipped beside the packages is what the code says."""

import re
from pathlib import Path

from tests.fakes.trueangled_process import trueangled

from trueangle.core.metrics import render_metric_table
from trueangle.core.register_table import render_csv, render_markdown

DEPLOY = Path(__file__).parents[2] / "deploy"
FIRST_GROUP = range(1, 7)


def test_the_shipped_register_tables_are_current() -> None:
    assert (DEPLOY / "registers.md").read_text("utf-8").strip() == render_markdown(FIRST_GROUP).strip()
    assert (DEPLOY / "registers.csv").read_text("utf-8").strip() == render_csv(FIRST_GROUP).strip()


def test_the_shipped_table_of_metrics_is_current() -> None:
    assert (DEPLOY / "metrics.md").read_text("utf-8").strip() == render_metric_table().strip()


GUIDE = (DEPLOY / "guide.md").read_text("utf-8")


def test_the_guide_names_every_unit_and_no_file_that_is_not_there() -> None:
    named = re.findall(r"(?<![/\w])((?:systemd|deploy)/[\w@.-]+\w)", GUIDE)
    assert len(named) >= 4
    assert [name for name in named if not (DEPLOY.parent / name).exists()] == []
    units = [path.name for path in (DEPLOY.parent / "systemd").rglob("*") if path.is_file()]
    assert len(units) >= 8
    assert [name for name in units if name not in GUIDE] == []


def test_the_guide_types_commands_and_options_that_there_are() -> None:
    typed = [" ".join(span.split()) for span in re.findall(r"`(trueangled [a-z][^`]*)`", GUIDE)]
    names = {line.split()[1] for line in typed}
    assert {"scan", "commission", "verify", "monitor", "record"} <= names
    known = {name: set(re.findall(r"--[a-z-]+", trueangled(name, "--help").stdout)) for name in names}
    for line in typed:
        name = line.split()[1]
        assert set(re.findall(r"--[a-z-]+", line)) <= known[name], line
    rest = GUIDE[GUIDE.index("## Commands for people") :]
    assert set(re.findall(r"--[a-z-]+", rest)) - set.union(*known.values()) == set()
