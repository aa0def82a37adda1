"""The page of a recording, as a process."""

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from tests.deploy.recorded_worlds import write_world
from tests.integration.page_client import connect_page, encode_camera, encode_update, read_messages
from tests.integration.processes import running, zensim


@pytest.fixture
def url(tmp_path: Path) -> Iterator[str]:
    path = write_world(tmp_path / "run.mcap")
    with running("view", "--recording", str(path), "--port", "0") as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()[-1]


def test_time_line_moves_the_recording(url: str) -> None:
    with closing(connect_page(url)) as connection:
        connection.send(encode_camera())
        slider = ""
        while True:
            for message in read_messages(connection.recv(timeout=30.0)):
                if message.get("props", {}).get("label") == "Position [s]":
                    slider = str(message["uuid"])
                content = str(message.get("updates", {}).get("content", ""))
                if slider and "of 0:10.00, playing" in content and "0:07" not in content:
                    connection.send(encode_update(slider, value=7.0))
                if "0:07" in content:
                    return


def test_a_file_that_is_no_recording_is_refused_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.mcap").write_bytes(b"no recording")

    done = zensim("view", "--recording", str(tmp_path / "a.mcap"), "--port", "0")

    assert done.returncode != 0
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    "arguments", [("--recording", "a.mcap", "--connect", "tcp/127.0.0.1:1"), ("--loop",)]
)
def test_options_that_do_not_fit_are_refused(arguments: tuple[str, ...]) -> None:
    done = zensim("view", *arguments, "--port", "0")

    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
