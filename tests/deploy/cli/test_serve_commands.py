"""`zensim serve` with wrong options."""

from pathlib import Path

import pytest

from tests.integration.processes import free_endpoint, run_in_process, zensim
from zensim.proto.exit_codes import ExitCode


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--step-hz", "0"), "--step-hz 0 is out of range; use 1 to 10000"),
        (("--rtf", "-1"), "--rtf -1 is out of range; use 0 to 1000"),
        (("--lockstep-timeout", "0"), "--lockstep-timeout 0 is out of range; use 0.01 to 3600"),
        (("--seed", "-1"), "--seed -1 is out of range; use 0 to 2^64 - 1"),
        (("--world-name", "my world"), "world 'my world' is not valid; use a letter"),
        (("--world", "mars"), "world 'mars' is neither a file nor one of empty"),
        (("--ros-domain", "999"), "ROS domain 999 is not valid; use 0 to 232"),
        (("--ros-domain", "zero"), "ROS domain 'zero' is not valid; use 0 to 232, or off"),
        (("--ros-distro", "hydro"), "--ros-distro must be one of humble, iron"),
        (("--listen", "here"), "endpoint 'here' is not valid; use protocol/host:port"),
    ],
    ids=str,
)
def test_serve_is_refused_in_one_line_for_mistyped_options(
    arguments: tuple[str, ...], message: str
) -> None:
    done = run_in_process("serve", *arguments)

    assert done.returncode == ExitCode.USAGE
    assert done.stderr.startswith("zensim serve: ")
    assert message in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_world_that_is_not_utf_8_is_named_so(tmp_path: Path) -> None:
    file = tmp_path / "latin.sdf"
    file.write_bytes("<sdf version='1.9'><world name='é'/></sdf>".encode("latin-1"))

    done = run_in_process("serve", "--world", str(file), "--listen", free_endpoint())

    assert done.returncode == ExitCode.USAGE
    assert "is not UTF-8" in done.stderr


def test_serve_is_refused_with_listen_and_connect() -> None:
    done = run_in_process("serve", "--listen", free_endpoint(), "--connect", free_endpoint())

    assert done.returncode == ExitCode.USAGE
    assert "--listen" in done.stderr


@pytest.mark.parametrize("is_in_file", [True, False])
def test_serve_listens_as_set_where_clients_have_an_exported_endpoint(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_in_file: bool
) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text("serve: {listen: here}\n" if is_in_file else "serve: {}\n")
    monkeypatch.setenv("ZENSIM_SERVE_LISTEN", "" if is_in_file else "here")
    monkeypatch.setenv("ZENSIM_CONNECT", "there")

    done = run_in_process("serve", "--config", str(file), "--wait", "0")

    assert done.returncode == ExitCode.USAGE
    assert "endpoint 'here' is not valid" in done.stderr


def test_variable_of_serve_beats_the_endpoint_in_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text("serve: {listen: here}\n")
    monkeypatch.setenv("ZENSIM_SERVE_CONNECT", "there")

    done = run_in_process("serve", "--config", str(file), "--wait", "0")

    assert "endpoint 'there' is not valid" in done.stderr


def test_serve_fails_without_a_router_to_connect_to() -> None:
    endpoint = free_endpoint()

    done = zensim("serve", "--connect", endpoint, "--wait", "0")

    assert done.returncode == ExitCode.UNREACHABLE
    assert done.stderr.startswith("zensim serve: ")
    assert done.stderr.count("\n") == 1


def test_serve_lists_the_policies_for_an_unknown_one() -> None:
    done = run_in_process("serve", "--on-miss", "panic")

    assert done.returncode == ExitCode.USAGE
    assert "'panic'" in done.stderr
