"""What is shipped beside the packages is what the code says."""

from pathlib import Path

from trueangle.core.metrics import render_metric_table
from trueangle.core.register_table import render_csv, render_markdown

DEPLOY = Path(__file__).parents[2] / "deploy"
FIRST_GROUP = range(1, 7)


def test_the_shipped_register_tables_are_current() -> None:
    assert (DEPLOY / "registers.md").read_text("utf-8").strip() == render_markdown(FIRST_GROUP).strip()
    assert (DEPLOY / "registers.csv").read_text("utf-8").strip() == render_csv(FIRST_GROUP).strip()


def test_the_shipped_table_of_metrics_is_current() -> None:
    assert (DEPLOY / "metrics.md").read_text("utf-8").strip() == render_metric_table().strip()
