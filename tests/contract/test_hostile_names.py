"""Names of files, networks and descriptions reach no reader as anything but text."""

import re
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

import zensim
from zensim.api.entity_values import make_html_table
from zensim.deploy import check_report, scenario_report
from zensim.deploy.robot_checks import CheckRow, RobotCheck, TrialResult
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.model_messages import Link, Model
from zensim.proto.messages.standard_messages import String
from zensim.proto.messages.telemetry_messages import EntityModel
from zensim.proto.printable_text import print_lines, to_file_name, to_html, to_markdown, to_xml
from zensim.recording.mcap_records import Channel, Schema
from zensim.recording.mcap_writer import McapWriter
from zensim.recording.message_series import MessageSeries
from zensim.recording.message_tables import read_tables
from zensim.recording.output_file import OutputFile
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.series_chart import draw_series
from zensim.recording.table_files import write_tables
from zensim.scenario.check_monitors import CheckResult
from zensim.scenario.scenario_runner import RunReport
from zensim.spawner.page.entity_panel import make_tree_html
from zensim.spawner.page.render_state import SimulationStatus
from zensim.spawner.page.side_panel import make_robot_html, make_status_html

NAMES = (
    "<img src=x onerror=alert(1)>",
    "\x1b]0;title\x07",
    "\x1b[2J\r\n::error::x",
    '"><script>alert(1)</script>',
    "' onmouseover='alert(1)",
    "]]></x><y>",
    "a|b\n| c | [d](javascript:alert(1)) `e`",
    "../../etc/passwd",
    "C:\\x\x00\u202e\ud800\ufffe",
    "-rf",
    "x" * 5000,
)
FORBIDDEN = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e\ufffe]")
"""Control characters, but those between lines."""
ESCAPES = re.compile(r"\b(html\.escape|from html import|saxutils|quoteattr)\b")


class TagFinder(HTMLParser):
    """Lists the tags of a page, and their attributes."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: set[str] = set()
        self.attributes: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}


def find_tags(page: str) -> TagFinder:
    finder = TagFinder()
    finder.feed(page)
    finder.close()
    return finder


@pytest.mark.parametrize("name", NAMES)
def test_terminal_gets_no_control_characters(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    print_lines(name)
    print_lines(name, err=True)

    assert not any(map(FORBIDDEN.search, capsys.readouterr()))


@pytest.mark.parametrize("name", NAMES)
def test_page_and_notebook_get_no_tags_of_a_name(name: str) -> None:
    model = Model(name, links=(Link(name),))
    pages = (
        make_tree_html(model),
        make_robot_html(EntityModel(name, name, 0), np.zeros(13), None),
        make_status_html(SimulationStatus(name)),
        make_html_table((name,), ((name,),)),
        f"<p title='{to_html(name)}'></p>",
    )

    found = [find_tags(page) for page in pages]

    assert not any(map(FORBIDDEN.search, pages))
    assert {tag for one in found for tag in one.tags} & {"img", "script", "x", "y"} == set()
    assert {name for one in found for name in one.attributes} <= {
        *("style", "title", "border", "class", "data-state")
    }


@pytest.mark.parametrize("name", NAMES)
def test_junit_of_a_name_is_xml_with_that_name(name: str) -> None:
    row = CheckRow(RobotCheck(name), name, "refused", TrialResult(error=name), name)
    failed = CheckResult(name, name, "failed", -1.0, "m", 1.0, name, message=name, place=name)
    run = RunReport(name, name, 7, name, checks=(failed,), error=name, repeat=name)

    for text in (check_report.to_junit([row]), scenario_report.to_junit([run])):
        root = ElementTree.fromstring(text)
        named = {one.get("classname") for one in root.iter("testcase")}

        assert named == {to_xml(name)}
        assert not FORBIDDEN.search(text.decode())


@pytest.mark.parametrize("name", NAMES)
def test_markdown_of_a_name_is_one_row_without_html(name: str) -> None:
    row = CheckRow(RobotCheck(name), "mujoco", "refused", TrialResult(error=name), name)
    failed = CheckResult(name, name, "failed", -1.0, "m", 1.0, name, message=name, place=name)
    run = RunReport(name, name, 7, name, checks=(failed,))

    for text in (check_report.format_markdown([row]), scenario_report.format_markdown([run])):
        rows = [line for line in text.splitlines() if line.startswith("|")]
        cells = {len(re.split(r"(?<!\\)\|", line)) for line in rows[-2:]}

        assert len(cells) == 1
        assert find_tags(text).tags == set()
        assert not FORBIDDEN.search(text)
    assert "](" not in to_markdown(name).replace("\\]", "")


@pytest.mark.parametrize("name", NAMES)
def test_svg_of_a_name_is_xml_without_tags_of_it(name: str, tmp_path: Path) -> None:
    series = MessageSeries(name, name, 0, np.arange(3.0), np.arange(3.0))

    draw_series([series], tmp_path / "a.svg", title=name)

    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    tags = {one.tag.rpartition("}")[2] for one in root.iter()}
    assert tags & {"img", "script", "x", "y"} == set()
    assert "svg" in tags


@pytest.mark.parametrize("name", NAMES)
def test_file_of_a_table_has_a_plain_name_in_its_folder(name: str, tmp_path: Path) -> None:
    output = OutputFile(tmp_path / "run.mcap")
    writer = McapWriter(output)
    writer.define(Schema(1, String.ros_type, "ros2msg", b"string data"))
    writer.define(Channel(1, 1, name.replace("\ud800", ""), "cdr", {}))
    writer.write_message(1, 5, 5, encode(String("a"), Format.CDR))
    writer.flush()
    writer.close()
    output.close()
    tables = read_tables(RecordingReader(tmp_path / "run.mcap"))

    (fact,) = write_tables(tables, tmp_path / "tables", "csv")

    (file,) = (tmp_path / "tables").glob("*.csv")
    assert file.name == fact.file
    assert file.name.isprintable()
    assert len(file.name) < 200
    assert fact.rows == 1


@pytest.mark.parametrize("name", NAMES)
def test_name_of_a_file_is_one_part_of_a_path(name: str) -> None:
    found = to_file_name(name)

    assert Path(found).name == found
    assert found.isprintable()
    assert not found.startswith(("-", "."))


def test_only_one_module_escapes_html_and_xml() -> None:
    root = Path(next(iter(zensim.__path__))).parent
    programs = ("proto", "sim_server", "spawner", "robot_agent", "zensim", "deploy")
    paths = [path for name in programs for path in (root / name).rglob("*.py")]

    found = {
        path.relative_to(root).as_posix()
        for path in paths
        if ESCAPES.search(path.read_text(encoding="utf-8"))
    }

    assert found == {
        "proto/printable_text.py",
        "spawner/spawn/description_sources.py",  # arguments in XML that a parser reads
    }
