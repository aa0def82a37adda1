"""Alert rules and dashboard: syntax and behaviour by promtool, names by docs/metrics.md."""

import json
from pathlib import Path

import pytest
import yaml

from tests.contract.repository import ROOT
from tests.deploy.monitoring_rules import (
    ALERTS,
    DASHBOARD,
    FOLDER,
    find_metrics,
    list_alert_queries,
    list_dashboard_queries,
    run_promtool,
)


def write_rules(path: Path, queries: list[str]) -> Path:
    """Write queries as recording rules, which is a form that promtool reads."""
    rules = [{"record": f"query_{number}", "expr": query} for number, query in enumerate(queries)]
    path.write_text(yaml.safe_dump({"groups": [{"name": "queries", "rules": rules}]}))
    return path


def test_alerts_are_rules_of_prometheus() -> None:
    done = run_promtool("check", "rules", str(ALERTS))

    assert done.returncode == 0, done.stdout + done.stderr


def test_each_alert_is_given_when_it_should_be_and_none_otherwise() -> None:
    done = run_promtool("test", "rules", "tests/deploy/alert_cases.yaml")

    assert done.returncode == 0, done.stdout + done.stderr


def test_each_alert_has_a_case() -> None:
    cases = (ROOT / "tests" / "deploy" / "alert_cases.yaml").read_text()
    groups = yaml.safe_load(ALERTS.read_text())["groups"]
    names = [rule["alert"] for group in groups for rule in group["rules"]]

    assert len(names) >= 10
    assert all(f'alertname="{name}"' in cases for name in names)


def test_alert_that_comes_too_early_fails_its_case(tmp_path: Path) -> None:
    (tmp_path / "alerts.yaml").write_text(ALERTS.read_text().replace("< 0.95", "<= 1"))
    cases = (ROOT / "tests" / "deploy" / "alert_cases.yaml").read_text()
    (tmp_path / "cases.yaml").write_text(
        cases.replace("../../deploy/monitoring/alerts.yaml", "alerts.yaml")
    )

    assert run_promtool("test", "rules", str(tmp_path / "cases.yaml")).returncode != 0


def test_configuration_of_prometheus_is_valid() -> None:
    done = run_promtool("check", "config", str(FOLDER / "prometheus.yaml"))

    assert done.returncode == 0, done.stdout + done.stderr


def test_queries_of_the_dashboard_are_promql(tmp_path: Path) -> None:
    queries = list_dashboard_queries()

    done = run_promtool("check", "rules", str(write_rules(tmp_path / "queries.yaml", queries)))

    assert len(queries) > 30
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("query", ["rate(zensim_steps_total)", "zensim_agents{world=~}", "sum by"])
def test_what_is_no_query_is_refused(query: str, tmp_path: Path) -> None:
    done = run_promtool("check", "rules", str(write_rules(tmp_path / "queries.yaml", [query])))

    assert done.returncode != 0


def test_panels_of_the_dashboard_do_not_overlap_and_have_a_query() -> None:
    panels = json.loads(DASHBOARD.read_text())["panels"]

    taken = [
        (x, y)
        for place in (panel["gridPos"] for panel in panels)
        for x in range(place["x"], place["x"] + place["w"])
        for y in range(place["y"], place["y"] + place["h"])
    ]
    assert len(taken) == len(set(taken))
    assert max(x for x, _ in taken) == 23
    assert len({panel["id"] for panel in panels}) == len(panels)
    assert all(panel.get("targets") for panel in panels if panel["type"] != "row")


def test_metrics_of_queries_are_documented() -> None:
    page = (ROOT / "docs" / "metrics.md").read_text()
    names = set().union(*map(find_metrics, [*list_alert_queries(), *list_dashboard_queries()]))

    missing = {name for name in names if name.startswith("zensim_") and base_of(name) not in page}

    assert len(names) > 25
    assert missing == set()


def base_of(name: str) -> str:
    for suffix in ("_bucket", "_count", "_sum"):
        name = name.removesuffix(suffix)
    return name
