"""`zensim serve` when it is mistyped, and `zensim model`."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from proto.exits import Exit
from sim_server.cli import app
from tests.integration.processes import free_endpoint, zensim

RUNNER = CliRunner()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--step-hz", "0"), "--step-hz 0 is out of range; use 1 to 10000"),
        (("--rtf", "-1"), "--rtf -1 is out of range; use 0 (flat out) or up to 1000"),
        (("--seed", "-1"), "--seed -1 is negative; use 0 or more"),
        (("--world-name", "my world"), "world 'my world' is not valid; use a letter"),
        (("--world", "mars"), "world 'mars' is neither a file nor one of empty"),
        (("--listen", "here"), "endpoint 'here' is not valid; use protocol/host:port"),
    ],
    ids=str,
)
def test_serve_is_refused_in_one_line_when_it_is_mistyped(
    arguments: tuple[str, ...], message: str
) -> None:
    done = zensim("serve", *arguments)

    assert done.returncode == Exit.USAGE
    assert done.stderr.startswith("zensim serve: USAGE (2): ")
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_serve_is_refused_when_it_is_to_listen_and_to_connect() -> None:
    done = zensim("serve", "--listen", free_endpoint(), "--connect", free_endpoint())

    assert done.returncode == Exit.USAGE
    assert "--listen and --connect exclude each other" in done.stderr


def test_serve_says_so_when_nobody_listens_where_it_is_to_connect() -> None:
    endpoint = free_endpoint()

    done = zensim("serve", "--connect", endpoint)

    assert done.returncode == Exit.UNREACHABLE
    assert done.stderr.startswith("zensim serve: UNREACHABLE (4): nobody listens at ")
    assert done.stderr.count("\n") == 1


def test_model_shows_a_tree_of_links() -> None:
    done = RUNNER.invoke(app, ["model", "box_bot"])

    assert done.exit_code == Exit.OK
    for name in ("base_link", "left_wheel", "right_wheel_joint"):
        assert name in done.stdout


def test_model_prints_json() -> None:
    done = RUNNER.invoke(app, ["model", "box_bot", "--json"])

    assert json.loads(done.stdout)["name"] == "box_bot"


def test_model_reads_a_file(tmp_path: Path) -> None:
    file = tmp_path / "dot.urdf"
    file.write_text('<robot name="dot"><link name="middle"/></robot>', encoding="utf-8")

    done = RUNNER.invoke(app, ["model", str(file)])

    assert done.exit_code == Exit.OK
    assert "middle" in done.stdout


@pytest.mark.parametrize(
    ("content", "status", "message"),
    [
        (b"<robot", Exit.FAILED, "zensim model: FAILED (1): "),
        (b'<robot name="r"/>', Exit.FAILED, "zensim model: FAILED (1): "),
        (b"\xff\xfe\x00", Exit.USAGE, "zensim model: USAGE (2): "),
    ],
)
def test_model_says_in_one_line_why_a_file_is_none(
    tmp_path: Path, content: bytes, status: Exit, message: str
) -> None:
    file = tmp_path / "broken.urdf"
    file.write_bytes(content)

    done = RUNNER.invoke(app, ["model", str(file)])

    assert (done.exit_code, done.stdout) == (status, "")
    assert done.stderr.startswith(message)
    assert done.stderr.count("\n") == 1


def test_model_says_so_when_there_is_no_such_file() -> None:
    done = RUNNER.invoke(app, ["model", "nowhere.urdf"])

    assert done.exit_code == Exit.NOT_FOUND
    assert done.stderr.startswith("zensim model: NOT_FOUND (3): nowhere.urdf: ")
