"""Runs of scenarios for tests."""

from zensim.deploy.scenario_process import RunRequest, run_all
from zensim.scenario.scenario_runner import RunReport


def run_alone(request: RunRequest) -> RunReport:
    """Run a scenario in a process of its own."""
    (report,) = run_all([request], jobs=1, on_run=lambda _: None)
    return report
