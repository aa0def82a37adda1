"""Numbers that options of recordings refuse before a file is opened."""

from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from zensim.proto.exit_codes import ExitCode
from zensim.recording.cli import bag_commands, record_commands, replay_commands


@pytest.mark.parametrize(
    ("app", "words"),
    [
        (replay_commands.app, ("none.mcap", "--start-offset", "inf")),
        (replay_commands.app, ("none.mcap", "--playback-duration", "nan")),
        (replay_commands.app, ("none.mcap", "--delay", "inf")),
        (replay_commands.app, ("none.mcap", "--start-offset", "1e300")),
        (bag_commands.app, ("convert", "none.mcap", "-o", "new.mcap", "--duration", "inf")),
        (bag_commands.app, ("convert", "none.mcap", "-o", "new.mcap", "-d", "1e300")),
        (record_commands.app, ("--all", "-o", "new", "--max-bag-duration", "inf")),
    ],
    ids=lambda one: " ".join(one[-2:]) if isinstance(one, tuple) else "",
)
def test_number_that_is_no_time_is_refused(
    app: typer.Typer,
    words: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)

    done = CliRunner().invoke(app, words)

    assert done.exit_code == ExitCode.USAGE
    assert isinstance(done.exception, SystemExit)
    assert [*tmp_path.iterdir()] == []
