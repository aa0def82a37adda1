"""Scenario files, runs and reports for the tests of sweeps."""

import math
from pathlib import Path

import msgspec

from zensim.deploy.sweep.sweep_plan import SweepRun
from zensim.deploy.sweep.sweep_rows import SweepRow
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.run_host import RunHost
from zensim.scenario.scenario_runner import RunReport

SHORT = """zensim: 1
name: short
robots: [{name: r, model: box_bot}]
behaviours: [{name: go, robots: r, do: drive, v: 0.3}]
checks: [{name: there, robots: r, that: reached, point: [0.15, 0], tolerance: 0.1, by: 0.5}]
end: {at: 0.5}
"""
"""A scenario of half a second that passes from v = 0.15 m/s on."""


def write_scenario(folder: Path, vary: str = "{}", text: str = SHORT) -> str:
    file = folder / "short.scenario.yaml"
    file.write_text(f"{text}vary: {vary}\n")
    return str(file)


def make_run(run_id: str = "a1", **values: object) -> SweepRun:
    run = SweepRun(run_id, 7, 0, 0, {"behaviours.go.v": 0.3}, (), "ff", 60.0)
    return msgspec.structs.replace(run, **values)


def make_report(**values: object) -> RunReport:
    checks = (
        CheckResult("there", "reached", "passed", 0.25, "m", 0.5),
        CheckResult("stops", "speed", "not_evaluated", math.nan),
    )
    report = RunReport(
        *("short", "short.scenario.yaml", 7, "ff", checks),
        state_hash="abc",
        sim_time=0.5,
        cpu_s=0.1,
        host=RunHost("h", "Linux", "CPU", {"zensim": "0.1.0"}),
    )
    return msgspec.structs.replace(report, **values)


def make_sweep_row(run_id: str, **values: object) -> SweepRow:
    row = SweepRow(id=run_id, seed=7, number=0, repeat=0, inputs={}, is_passed=True, digest="abc")
    return msgspec.structs.replace(row, **values)
