"""Reports of scenario runs."""

import json
import math
from xml.etree import ElementTree

import msgspec

from zensim.deploy.scenario_report import format_markdown, format_run, to_json, to_junit
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.scenario_runner import RunReport

PASSED = CheckResult("near", "distance", "passed", 0.25, "m", 1.5, "r0, r1", place="a.yaml:4")
FAILED = CheckResult(
    *("slow", "speed", "failed", -0.5, "m/s", 2.0, "r0"), message="missed <b>", place="a.yaml:5"
)
UNSEEN = CheckResult("stops", "speed", "not_evaluated", math.nan, message="never", place="a.yaml:6")
RUN = RunReport(
    *("a", "a.yaml", 7, "ff"),
    checks=(PASSED, FAILED, UNSEEN),
    state_hash="abc",
    wall_time_s=2.0,
    repeat="zensim test a.yaml",
)


def test_run_passes_with_its_checks() -> None:
    assert not RUN.is_passed
    assert msgspec.structs.replace(RUN, checks=(PASSED,)).is_passed
    assert not msgspec.structs.replace(RUN, checks=(PASSED,), error="it hung").is_passed
    warning = msgspec.structs.replace(FAILED, severity="warn")
    assert msgspec.structs.replace(RUN, checks=(PASSED, warning)).is_passed


def test_text_names_failure_place_and_repeat() -> None:
    text = "\n".join(format_run(RUN))

    assert "a.yaml:5" in text
    assert "zensim test a.yaml" in text


def test_junit_counts_checks_and_names_place_and_margin() -> None:
    suites = ElementTree.fromstring(to_junit([RUN]))

    suite = suites[0]
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "2", "0")
    assert {one.get("name"): one.get("value") for one in suite.iter("property")} == {
        "seed": "7",
        "state_hash": "abc",
        "sha256": "ff",
        "version": "",
        "repeat": "zensim test a.yaml",
        "recording": "",
    }
    failure = suite.findall("testcase")[1][0]
    assert (failure.tag, failure.get("message")) == ("failure", "missed <b>")
    assert "a.yaml:5" in (failure.text or "")
    assert "-0.5 m/s" in (failure.text or "")


def test_run_that_did_not_end_is_an_error_in_junit() -> None:
    suites = ElementTree.fromstring(to_junit([RunReport("a", "a.yaml", 0, "", error="timeout")]))

    assert suites.get("errors") == "1"
    assert suites.find(".//error") is not None


def test_json_has_no_numbers_that_json_lacks() -> None:
    found = json.loads(json.dumps(to_json([RUN]), allow_nan=False))

    assert found[0]["checks"][2]["margin"] is None
    assert found[0]["is_passed"] is False


def test_markdown_has_a_row_for_each_check() -> None:
    lines = format_markdown([RUN]).splitlines()

    assert len([line for line in lines if line.startswith("| a |")]) == 3
    assert "0 of 1 passed" in lines
