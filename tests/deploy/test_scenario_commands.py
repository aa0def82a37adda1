"""`zensim scenario` and `zensim test`: output, files and exit status."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner, Result

from zensim.deploy.cli import build
from zensim.proto.exit_codes import ExitCode
from zensim.scenario.scenario_reader import list_shipped_scenarios

RUNNER = CliRunner()
GOOD = (
    "zensim: 1\nrobots:\n  - {name: r, model: box_bot}\n"
    "behaviours:\n  - {name: go, robots: r, do: drive, v: {uniform: [0.2, 0.3]}}\n"
    "checks:\n  - {name: there, robots: r, that: reached, point: [0.3, 0], by: 2}\nend: {at: 2}\n"
)
FAILING = GOOD.replace("[0.3, 0]", "[9, 0]")
BROKEN = "zensim: 1\ntime: {mode: lock}\nnome: x\n"


def call(*words: str) -> Result:
    return RUNNER.invoke(build(words[0]), list(words))


def write(folder: Path, text: str, name: str = "a") -> str:
    file = folder / f"{name}.scenario.yaml"
    file.write_text(text)
    return str(file)


def test_check_prints_every_mistake_with_its_line(tmp_path: Path) -> None:
    file = write(tmp_path, BROKEN)

    done = call("scenario", "check", file)

    assert done.exit_code == ExitCode.USAGE
    starts = [": ".join(line.split(": ")[:2]) for line in done.stdout.splitlines()]
    assert starts == [f"{file}:2:14: time.mode", f"{file}:3:1: nome"]


def test_check_prints_json(tmp_path: Path) -> None:
    done = call("scenario", "check", write(tmp_path, BROKEN), "--json")

    assert {(one["line"], one["path"]) for one in json.loads(done.stdout)} == {
        (2, "time.mode"),
        (3, "nome"),
    }


def test_check_accepts_the_shipped_scenarios() -> None:
    names = list_shipped_scenarios()

    assert len(names) == 5
    assert call("scenario", "check", *names).exit_code == ExitCode.OK


def test_list_and_schema_print_json() -> None:
    listed = json.loads(call("scenario", "list", "--json").stdout)
    schema = json.loads(call("scenario", "schema", "--json").stdout)

    assert [one["name"] for one in listed] == list(list_shipped_scenarios())
    assert all(Path(one["file"]).is_file() for one in listed)
    assert schema == json.loads(call("scenario", "schema").stdout)


def test_list_prints_names_only_when_quiet() -> None:
    done = call("scenario", "list", "--quiet")

    assert done.stdout.split() == list(list_shipped_scenarios())


def test_check_of_a_missing_file_says_so() -> None:
    assert call("scenario", "check", "no_such_file").exit_code == ExitCode.NOT_FOUND


def test_schema_is_json() -> None:
    assert json.loads(call("scenario", "schema").stdout)["type"] == "object"


def test_list_names_the_shipped_scenarios() -> None:
    lines = call("scenario", "list").stdout.splitlines()

    assert [line.split()[0] for line in lines] == list_shipped_scenarios()


def test_passing_run_writes_its_reports(tmp_path: Path) -> None:
    junit, table = (tmp_path / name for name in ("r.xml", "r.md"))

    done = call(
        *("test", write(tmp_path, GOOD), "--repeat", "2", "--junit", str(junit)),
        *("--json", "--markdown", str(table)),
    )

    assert done.exit_code == ExitCode.OK, done.output
    assert ElementTree.parse(junit).getroot().get("tests") == "2"
    runs = json.loads(done.stdout)
    assert runs[0]["state_hash"] == runs[1]["state_hash"] != ""
    assert "2 of 2 passed" in table.read_text()


def test_failing_run_fails(tmp_path: Path) -> None:
    file = write(tmp_path, FAILING)

    done = call("test", file)

    assert done.exit_code == ExitCode.FAILED
    assert f"{file}:7" in done.stdout
    assert f"repeat: zensim test {file}" in done.stdout


def test_all_files_are_checked_before_the_first_run(tmp_path: Path) -> None:
    write(tmp_path, GOOD, "a")
    write(tmp_path, BROKEN, "b")

    done = call("test", str(tmp_path))

    assert done.exit_code == ExitCode.USAGE
    assert "passed" not in done.stdout


@pytest.mark.parametrize(
    ("body", "word"),
    [
        # A loop would hang as well, and take a core.
        ("__import__('threading').Event().wait()", "timeout"),
        ("raise ArithmeticError('no')", "authors_trouble.py:5"),
    ],
    ids=["hangs", "raises"],
)
def test_code_that_hangs_or_raises_is_an_error_of_its_run(
    body: str, word: str, tmp_path: Path
) -> None:
    (tmp_path / "authors_trouble.py").write_text(
        "class Control:\n    def __init__(self, sim, robots):\n        pass\n"
        f"    def step(self, now, state):\n        {body}\n"
    )
    text = GOOD.replace(
        "do: drive, v: {uniform: [0.2, 0.3]}", "do: python, call: 'authors_trouble:Control'"
    )
    files = (write(tmp_path, text, "bad"), write(tmp_path, GOOD))

    # The good run, too, has to end in time, on a machine with other work.
    for limit in ("5", "25", "125"):
        done = call("test", *files, "--timeout", limit)
        if "a: passed" in done.stdout:
            break

    assert done.exit_code == ExitCode.FAILED
    assert word in done.stdout
    assert "a: passed" in done.stdout
