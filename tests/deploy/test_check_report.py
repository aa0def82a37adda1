"""Rows of robot checks as table, Markdown, JSON and JUnit XML."""

import json
from xml.etree import ElementTree

import msgspec

from zensim.deploy.check_report import (
    HEADERS,
    MARKDOWN_HEADERS,
    format_cells,
    format_markdown,
    format_table,
    format_totals,
    to_json,
    to_junit,
)
from zensim.deploy.robot_checks import CheckRow, DrivenPart, RobotCheck, TrialResult

GOOD = CheckRow(
    RobotCheck("good.urdf", source="me/robots@1234567, MIT"),
    "pybullet",
    "ok",
    TrialResult(
        model="good",
        drive="diff_drive",
        drive_source="plug-in",
        straight=DrivenPart((0.2, 0.0, 0.0), (0.198, 0.0, -0.0001), (0.2, 0.0, 0.0)),
        turn=DrivenPart((0.0, 0.0, 0.5), (0.0, 0.0, 0.45), (0.0, 0.0, 0.5)),
    ),
)
OFF = CheckRow(RobotCheck("off.urdf", "a|b"), "mujoco", "off", GOOD.result, "turns at 0.90")
REFUSED = CheckRow(
    RobotCheck("x/<broken>.urdf"), "mujoco", "refused", TrialResult(error="bad \x00"), "bad \x00"
)
ROWS = (GOOD, OFF, REFUSED)


def test_cells_have_the_figures() -> None:
    cells = dict(zip(HEADERS, format_cells(GOOD), strict=True))

    assert cells["straight"] == "0.198 of 0.200 m/s (99 %)"
    assert cells["turn"] == "0.450 of 0.500 rad/s (90 %)"
    assert cells["predicted"] == "0.200 m/s, 0.500 rad/s"
    assert (cells["robot"], cells["drive"], cells["found by"]) == ("good", "diff", "plug-in")


def test_a_robot_that_was_not_spawned_has_no_figures() -> None:
    cells = dict(zip(HEADERS, format_cells(REFUSED), strict=True))

    assert cells["robot"] == "<broken>.urdf"
    assert {cells[name] for name in ("drive", "straight", "drift", "turn", "tilt", "creep")} == {
        "-"
    }


def test_table_has_a_line_for_each_row_between_headers_and_counts() -> None:
    lines = format_table(ROWS)

    assert len(lines) == len(ROWS) + 2
    assert "1 ok" in lines[-1]


def test_markdown_cells_are_escaped() -> None:
    lines = format_markdown(ROWS).partition("\n\n")[2].splitlines()

    columns = {line.replace(r"\|", "").count("|") for line in lines[: len(ROWS) + 2]}
    assert columns == {len(MARKDOWN_HEADERS) + 1}
    assert "<broken>" not in lines[4]
    assert GOOD.robot.source in lines[2]


def test_totals_count_the_robots_of_each_engine() -> None:
    straight = msgspec.structs.replace(GOOD.result, turn=GOOD.result.straight)

    headers, *totals = format_totals((*ROWS, msgspec.structs.replace(GOOD, result=straight)))

    assert [dict(zip(headers, cells, strict=True)) for cells in totals] == [
        {
            "engine": "pybullet", "robots": "2", "mobile": "2", "driven": "2",
            "straight within 5 %": "2", "turn within 5 %": "0", "both": "0",
            "ok or as predicted": "2",
        },
        {
            "engine": "mujoco", "robots": "2", "mobile": "1", "driven": "1",
            "straight within 5 %": "1", "turn within 5 %": "0", "both": "0",
            "ok or as predicted": "0",
        },
    ]  # fmt: skip
    assert format_markdown(ROWS).startswith("| engine | robots |")


def test_json_has_rows_and_counts() -> None:
    found = json.loads(json.dumps(to_json(ROWS)))

    assert [row["is_passed"] for row in found["rows"]] == [True, False, False]
    assert found["verdicts"] == {"ok": 1, "off": 1, "refused": 1}


def test_junit_has_a_suite_per_engine_and_a_case_per_robot() -> None:
    root = ElementTree.fromstring(to_junit(ROWS))

    suites = {suite.get("name", "").split()[-1]: suite for suite in root}
    assert root.tag == "testsuites"
    assert (root.get("tests"), root.get("failures"), root.get("errors")) == ("3", "1", "1")
    assert [case.get("name") for case in suites["pybullet"]] == ["good"]
    assert [[child.tag for child in case] for case in suites["mujoco"]] == [
        ["failure", "system-out"],
        ["error", "system-out"],
    ]
