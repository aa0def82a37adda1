"""Queries of the alert rules and of the dashboard, and promtool, which checks them."""

import json
import re
import subprocess
from collections.abc import Iterator

import yaml

from tests.contract.repository import ROOT

FOLDER = ROOT / "deploy" / "monitoring"
ALERTS, DASHBOARD = FOLDER / "alerts.yaml", FOLDER / "dashboard.json"
METRIC = re.compile(r"\b(?:zensim|process)_[a-z_]+\b(?!\s*[=!]~?)")
GRAFANA_VALUES = {"$world": ".*", "$__rate_interval": "5m"}


def list_alert_queries() -> list[str]:
    """List the queries of the alert rules."""
    groups = yaml.safe_load(ALERTS.read_text())["groups"]
    return [rule["expr"] for group in groups for rule in group["rules"]]


def list_dashboard_queries() -> list[str]:
    """List the queries of the dashboard, with values for what Grafana fills in."""
    return [fill_in(query) for query in _list_written_queries()]


def _list_written_queries() -> Iterator[str]:
    dashboard = json.loads(DASHBOARD.read_text())
    for panel in dashboard["panels"]:
        yield from (target["expr"] for target in panel.get("targets", ()))


def fill_in(query: str) -> str:
    """Replace the variables of Grafana in a query."""
    for name, value in GRAFANA_VALUES.items():
        query = query.replace(name, value)
    return query


def find_metrics(query: str) -> set[str]:
    """Find the names of the metrics of zensim in a query."""
    return set(METRIC.findall(query))


def run_promtool(*words: str) -> "subprocess.CompletedProcess[str]":
    """Run promtool, which is brought if it is not here."""
    found = subprocess.run(
        ["sh", str(ROOT / ".ci" / "promtool")], capture_output=True, text=True, check=True
    )
    return subprocess.run(
        [found.stdout.split()[-1], *words], capture_output=True, text=True, check=False, cwd=ROOT
    )
