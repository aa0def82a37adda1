"""Reports of scenario runs: text, JUnit XML, JSON and Markdown."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import msgspec

from zensim.deploy.check_report import format_markdown_table
from zensim.proto.printable_text import to_xml

if TYPE_CHECKING:
    from collections.abc import Sequence

    from zensim.scenario.check_monitors import CheckResult
    from zensim.scenario.scenario_runner import RunReport

HEAD = ("scenario", "check", "verdict", "margin", "at", "robots", "remark")


def format_run(run: RunReport) -> list[str]:
    """Format a run as lines of text: its verdict, then each check that did not pass."""
    verdict = "passed" if run.is_passed else "error" if run.error else "FAILED"
    pace = run.sim_time / run.wall_time_s if run.wall_time_s else 0.0
    head = f"{run.name}: {verdict}, {run.robots} robots, {run.sim_time:.2f} s ({pace:.1f} x real)"
    lines = [head, *([f"  {run.error}"] if run.error else [])]
    for check in run.checks:
        mark = {"passed": "ok"}.get(check.verdict, check.verdict)
        warn = " (warning only)" if check.severity == "warn" and check.verdict != "passed" else ""
        lines.append(f"  {mark:<13} {check.name}: margin {format_margin(check)}{warn}")
        if check.message:
            lines.append(f"  {'':<13} {check.message} ({check.place})")
    if run.recording:
        lines.append(f"  recording: {run.recording}")
    return lines if run.is_passed or not run.repeat else [*lines, f"  repeat: {run.repeat}"]


def format_margin(check: CheckResult) -> str:
    """Write a margin with its unit and time; - if it was not evaluated."""
    if math.isnan(check.margin):
        return "-"
    margin = f"{check.margin:+.4g} {check.unit}".strip()
    return margin if math.isnan(check.time) else f"{margin} at {check.time:.3f} s"


def to_json(runs: Sequence[RunReport]) -> list[object]:
    """Convert runs to JSON values; what is not a finite number becomes null."""
    return [
        {**_to_plain(run), "is_passed": run.is_passed}  # type: ignore[dict-item]
        for run in runs
    ]


def _to_plain(value: object) -> object:
    plain = msgspec.to_builtins(value)
    if isinstance(plain, dict):
        return {key: _to_plain(one) for key, one in plain.items()}
    if isinstance(plain, list | tuple):
        return [_to_plain(one) for one in plain]
    return None if isinstance(plain, float) and not math.isfinite(plain) else plain


def format_markdown(runs: Sequence[RunReport]) -> str:
    """Format all checks of all runs as a Markdown table."""
    rows: list[tuple[str, ...]] = [HEAD]
    for run in runs:
        if run.error:
            rows.append((run.name, "-", "error", "-", "-", "-", run.error))
        rows += [
            (
                *(run.name, check.name, check.verdict, format_margin(check).split(" at ")[0]),
                "-" if math.isnan(check.time) else f"{check.time:.3f} s",
                check.robot or "-",
                check.message or "-",
            )
            for check in run.checks
        ]
    passed = sum(run.is_passed for run in runs)
    return "\n".join([*format_markdown_table(rows), "", f"{passed} of {len(runs)} passed", ""])


def to_junit(runs: Sequence[RunReport]) -> bytes:
    """Convert runs to JUnit XML: a suite for each run, a case for each check."""
    root = ElementTree.Element("testsuites")
    for run in runs:
        _add_suite(root, run)
    totals = [suite.attrib for suite in root]
    for key in ("tests", "failures", "errors"):
        root.set(key, str(sum(int(one[key]) for one in totals)))
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)) + b"\n"


def _add_suite(root: ElementTree.Element, run: RunReport) -> None:
    failures = sum(check.is_failure for check in run.checks)
    suite = ElementTree.SubElement(
        root,
        "testsuite",
        {
            "name": to_xml(run.file),
            "tests": str(len(run.checks) + bool(run.error)),
            "failures": str(failures),
            "errors": str(int(bool(run.error))),
            "time": f"{run.wall_time_s:.3f}",
        },
    )
    properties = ElementTree.SubElement(suite, "properties")
    for name in ("seed", "state_hash", "sha256", "version", "repeat", "recording"):
        value = to_xml(str(getattr(run, name)))
        ElementTree.SubElement(properties, "property", {"name": name, "value": value})
    for check in run.checks:
        _add_case(suite, run, check)
    if run.error:
        case = ElementTree.SubElement(
            suite, "testcase", {"name": "run", "classname": to_xml(run.name)}
        )
        ElementTree.SubElement(case, "error", {"type": "error", "message": to_xml(run.error)})


def _add_case(suite: ElementTree.Element, run: RunReport, check: CheckResult) -> None:
    case = ElementTree.SubElement(
        suite, "testcase", {"name": to_xml(check.name), "classname": to_xml(run.name)}
    )
    if check.is_failure:
        failure = ElementTree.SubElement(
            case, "failure", {"type": check.verdict, "message": to_xml(check.message)}
        )
        failure.text = to_xml(
            f"{check.place}: {check.name}: margin {format_margin(check)}\nrepeat: {run.repeat}"
        )
    elif check.message:
        output = ElementTree.SubElement(case, "system-out")
        output.text = to_xml(f"warning: {check.message}")
