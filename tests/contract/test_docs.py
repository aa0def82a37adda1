"""Documents against the repository: links, commands, change log."""

import json
import os
import re
import subprocess
import sys
import textwrap
from collections import Counter
from importlib.metadata import version
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from tests.contract.repository import ROOT, files, shown, text_of
from tests.integration.processes import run_in_process
from zensim.deploy.cli import VERBS

LINK = re.compile(r"\]\((?!https?:|mailto:|#)([^)#\s]+)")
BLOCK_FLAGS = re.MULTILINE | re.DOTALL
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(
    r"(?:^|`|\s)(?:\.venv/bin/)?zensim "
    r"((?:(?:bag|state|info|token|world) )?[a-z][a-z0-9-]*)([^`\n|&;#]*)"
)
OPTION = re.compile(r"(?<=\s)--?[A-Za-z][\w-]*")
CHANGES = {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}
READMES = ("README.md", "README.zh-CN.md")
CONTENTS = ROOT / "docs" / "contents.md"
HEADING = re.compile(r"^## ", re.MULTILINE)
ORDER = ("Start", "How-to", "Reference", "Explanation", "Results")
REPLACED_BY = re.compile(r"^Replaced by \[ADR \d+\]\(([^)]+)\)", re.MULTILINE)
REPLACES = re.compile(r"^Replaces \[ADR \d+\]\(([^)]+)\)", re.MULTILINE)
MAX_README_WORDS = 900
MAX_ADR_LINES = 45
MAX_COLUMNS = 120
SOURCE_PATH = re.compile(
    r"`((?:proto|sim_server|spawner|robot_agent|deploy|tests|benchmarks)/[\w/.-]+)`"
)


def documents() -> list[Path]:
    return [path for path in files() if path.suffix == ".md"]


def broken_links(path: Path) -> list[str]:
    targets = LINK.findall(FENCE.sub("", text_of(path)))
    return [target for target in targets if not (path.parent / target).exists()]


def commands_shown() -> dict[str, set[str]]:
    """Collect the verbs of `zensim` that documents show, each with the options shown."""
    shown_options: dict[str, set[str]] = {}
    for path in documents():
        for verb, rest in COMMAND.findall("\n".join(code_of(text_of(path)))):
            shown_options.setdefault(verb, set()).update(OPTION.findall(rest))
    return shown_options


def code_of(text: str) -> list[str]:
    return FENCE.findall(text) + re.findall(r"`[^`\n]+`", FENCE.sub("", text))


PLAIN = {"COLUMNS": "200", "NO_COLOR": "1", "TERM": "dumb"}


def help_of(verb: str) -> subprocess.CompletedProcess[str]:
    """Get what `zensim VERB --help` prints, without a process for each."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in PLAIN.items():
            patch.setenv(name, value)
        return run_in_process(*verb.split(), "--help")


def test_installed_command_prints_the_same_help() -> None:
    done = subprocess.run(
        [Path(sys.executable).with_name("zensim"), "up", "--help"],
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, **PLAIN},
    )

    assert done.stdout == help_of("up").stdout


@pytest.mark.parametrize("path", documents(), ids=shown)
def test_links_of_a_document_exist(path: Path) -> None:
    assert broken_links(path) == []


@pytest.mark.parametrize(("verb", "options"), sorted(commands_shown().items()))
def test_documented_command_exists(verb: str, options: set[str]) -> None:
    answer = help_of(verb)

    assert answer.returncode == 0, answer.stderr
    known = set(OPTION.findall(answer.stdout.replace(",", " , ")))
    assert options <= known


@pytest.mark.parametrize("verb", VERBS)
def test_page_of_commands_names_every_verb(verb: str) -> None:
    rows = re.findall(r"^\| .*", text_of(ROOT / "docs" / "commands.md"), re.MULTILINE)

    assert any(f"`zensim {verb}" in row for row in rows)


def blocks_of(language: str) -> list[tuple[str, str]]:
    """List the code blocks in a language, with the document and line of each."""
    found = []
    for path in documents():
        text = text_of(path)
        for block in re.finditer(rf"^( *)```{language}\n(.*?)^ *```$", text, BLOCK_FLAGS):
            line = text.count("\n", 0, block.start()) + 1
            found.append((f"{shown(path)}:{line}", textwrap.dedent(block.group(2))))
    return found


@pytest.mark.parametrize(("place", "code"), blocks_of("python"))
def test_python_of_a_document_compiles(place: str, code: str) -> None:
    compile(code, place, "exec")


@pytest.mark.parametrize(("place", "code"), blocks_of("(?:xml|sdf|urdf)"))
def test_xml_of_a_document_is_well_formed(place: str, code: str) -> None:
    fragment = re.sub(r"<\?xml.*?\?>", "", code)

    root = ElementTree.fromstring(f"<root xmlns:zensim='z' xmlns:xacro='x'>{fragment}</root>")

    assert len(root) > 0, place


@pytest.mark.parametrize(("place", "code"), blocks_of("yaml"))
def test_yaml_of_a_document_is_read(place: str, code: str) -> None:
    assert yaml.safe_load(code), place


@pytest.mark.parametrize(("place", "code"), blocks_of("json"))
def test_json_of_a_document_is_read(place: str, code: str) -> None:
    assert json.loads(code), place


@pytest.mark.parametrize("name", READMES)
def test_first_commands_of_a_readme_start_the_demo_and_the_tests(name: str) -> None:
    first, *_ = FENCE.findall(text_of(ROOT / name))

    assert first.splitlines()[1:-1] == ["make demo", "make test"]


def test_readmes_have_the_same_commands() -> None:
    blocks = [FENCE.findall(text_of(ROOT / name)) for name in READMES]

    english, chinese = ([re.sub(r" *#.*", "", block) for block in one] for one in blocks)
    assert english == chinese


def test_readmes_have_the_same_sections_and_links() -> None:
    english, chinese = (FENCE.sub("", text_of(ROOT / name)) for name in READMES)

    assert len(HEADING.findall(english)) == len(HEADING.findall(chinese))
    assert set(LINK.findall(english)) - {"README.zh-CN.md"} == (
        set(LINK.findall(chinese)) - {"README.md"}
    )


def test_readme_is_read_in_five_minutes() -> None:
    assert len(text_of(ROOT / "README.md").split()) <= MAX_README_WORDS


def test_list_of_documents_names_each() -> None:
    named = {(ROOT / "docs" / one).resolve() for one in LINK.findall(text_of(CONTENTS))}

    pages = {*(ROOT / "docs").glob("*.md")} - {CONTENTS, ROOT / "docs" / "pypi.md"}
    assert [shown(one) for one in sorted(pages - named)] == []


def test_change_log_has_its_format() -> None:
    text = text_of(ROOT / "CHANGELOG.md")

    headings = re.findall(r"^## (.+)$", text, re.MULTILINE)
    kinds = re.findall(r"^### (.+)$", text, re.MULTILINE)
    assert headings[0] == "[Unreleased]"
    assert headings[1].startswith(f"[{version('zensim')}]")
    assert all(re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", h) for h in headings[1:])
    assert set(kinds) <= CHANGES
    assert re.search(r"^- \S", text, re.MULTILINE)


@pytest.mark.parametrize("path", sorted((ROOT / "docs" / "adr").glob("*.md")), ids=shown)
def test_decision_record_has_its_format(path: Path) -> None:
    text = text_of(path)

    parts = re.findall(r"^\*\*(\w+)\.\*\*", text, re.MULTILINE)
    assert re.fullmatch(r"\d{4}-[a-z0-9-]+\.md", path.name)
    assert text.startswith(f"# {int(path.name[:4])}. ")
    assert parts == ["Context", "Decision", "Consequences"]
    assert text.count("\n") <= MAX_ADR_LINES


def test_decisions_are_numbered_once() -> None:
    numbers = Counter(path.name[:4] for path in (ROOT / "docs" / "adr").glob("*.md"))

    assert [number for number, count in numbers.items() if count > 1] == []


def test_replaced_decisions_name_what_replaces_them_and_are_named_by_it() -> None:
    replaced, replacing = set(), set()
    for path in (ROOT / "docs" / "adr").glob("*.md"):
        text = text_of(path)
        replaced |= {(path.name, target) for target in REPLACED_BY.findall(text)}
        replacing |= {(target, path.name) for target in REPLACES.findall(text)}

    assert replaced == replacing != set()


def test_documents_are_in_the_order_of_a_reader() -> None:
    nav = yaml.safe_load(text_of(ROOT / ".mkdocs.yml"))["nav"]
    tabs = [next(iter(one)) for one in nav]
    parts = re.findall(r"^- \*\*(.+?)\*\*", text_of(CONTENTS), re.MULTILINE)

    assert tabs == ["Home", *ORDER]
    assert [one for one in parts if one in ORDER] == list(ORDER)


def test_lines_of_documents_are_short() -> None:
    """Code and rows of tables cannot be wrapped, and a link may be longer than a line."""
    long = [
        f"{shown(path)}:{number}"
        for path in documents()
        for number, line in enumerate(FENCE.sub("", text_of(path)).splitlines(), start=1)
        if len(line) > MAX_COLUMNS and not line.startswith("|") and " " in line.strip()
    ]

    assert long == []


@pytest.mark.parametrize("path", documents(), ids=shown)
def test_source_that_a_document_names_exists(path: Path) -> None:
    named = SOURCE_PATH.findall(text_of(path))

    assert [name for name in named if not (ROOT / name).exists() and "NEW_" not in name] == []
