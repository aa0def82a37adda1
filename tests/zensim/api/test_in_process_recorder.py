"""`World.record`: what a world in process writes, and that equal runs write equal files."""

import json
import os
from pathlib import Path

import pytest

import zensim
from tests.recording.recordings import count_by_mcap, count_by_rosbags
from zensim.api import in_process_recorder
from zensim.recording import recording_parts
from zensim.recording.recording_parts import DiskFull, RecordingParts

RUN_S = 1.0


def run(file: Path | None, *topics: str, rate: float = 0.0) -> str:
    """Run two worlds' worth of time with a reset between; return the last state."""
    with zensim.World("walls", seed=3) as world:
        if file is not None:
            world.record(file, *topics, rate=rate)
        world.spawn("box_bot_lidar", "r1").drive(0.3, 0.2)
        world.run_for(RUN_S)
        world.reset()
        world.spawn("box_bot", "r2").drive(0.3)
        world.run_for(RUN_S)
        return world.state_hash()


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("recorded") / "run.mcap"
    run(file)
    return file


def test_equal_runs_give_equal_files_and_a_recorder_changes_no_state(tmp_path: Path) -> None:
    states = {run(tmp_path / "a.mcap"), run(tmp_path / "b.mcap"), run(None)}

    assert len(states) == 1
    for first, second in (("a.mcap", "b.mcap"), ("a_1.mcap", "b_1.mcap")):
        assert (tmp_path / first).read_bytes() == (tmp_path / second).read_bytes()


def test_recorder_that_cannot_begin_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError("no more handles")

    with zensim.World() as world:
        with monkeypatch.context() as patched:
            patched.setattr(in_process_recorder, "EntityFiles", refuse)
            with pytest.raises(OSError, match="handles"):
                world.record(tmp_path / "run.mcap")
        left = list(tmp_path.iterdir())
        world.record(tmp_path / "run.mcap")
        world.run_for(0.1)

    assert left == []
    assert zensim.Recording(tmp_path / "run.mcap").counts["/clock"] > 5


def test_readers_that_are_not_ours_find_all_topics(recorded: Path) -> None:
    counts = count_by_mcap(recorded)

    assert counts == count_by_rosbags(recorded)
    assert counts["/r1/odom"] == counts["/r1/tf"] == counts["/clock"] > 50
    assert counts["/r1/scan"] == 10
    assert counts["/sim/default/snapshot"] > 20


def test_reset_begins_a_file_whose_times_begin_anew(recorded: Path) -> None:
    second = zensim.Recording(recorded.with_name("run_1.mcap"))

    assert second.start == 0.0
    assert second.end == pytest.approx(RUN_S, abs=1e-6)
    assert {"/r2/odom", "/clock", "/sim/default/snapshot"} <= set(second.topics)
    assert "/r1/odom" not in second.topics
    assert second.counts["/clock"] > 50


def test_stamps_are_simulation_time(recorded: Path) -> None:
    for message in zensim.Recording(recorded).messages("r1/odom"):
        stamp = message.data.header.stamp  # type: ignore[attr-defined]
        assert message.time == message.published == stamp.sec + stamp.nanosec / 1e9


def test_requests_that_change_the_world_are_readable(recorded: Path) -> None:
    texts = [
        json.loads(message.data.data)  # type: ignore[attr-defined]
        for message in zensim.Recording(recorded).messages("sim/default/requests")
    ]

    assert [one["service"] for one in texts] == ["spawn_entity", "reset_simulation"]
    assert texts[0]["request"]["name"] == "r1"
    assert (texts[0]["code"], texts[1]["step"]) == (1, 240 * RUN_S)


def test_models_and_facts_are_attached(recorded: Path) -> None:
    first = zensim.Recording(recorded)
    last = zensim.Recording(recorded.with_name("run_1.mcap"))

    assert b"<sdf" in first.attachment("world.sdf")
    assert any(name.startswith("descriptions/") for name in first.attachments)
    facts = json.loads(last.attachment("zensim.json"))
    assert (facts["recorded"]["lost"], facts["start"]["wall_ns"]) == (0, 0)
    assert last.metadata["zensim"]["seed"] == "3"


def test_topics_and_rate_are_chosen(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"

    run(file, "*/odom", rate=10.0)

    assert list(zensim.Recording(file).counts) == ["/r1/odom"]
    assert 9 <= zensim.Recording(file).counts["/r1/odom"] <= 11


def test_recorder_ends_before_its_world(tmp_path: Path) -> None:
    with zensim.World() as world:
        world.spawn("box_bot", "r1")
        with world.record(tmp_path / "run.mcap", "*/odom") as recorder:
            world.run_for(0.5)
        count = recorder.read().counts["/r1/odom"]
        world.run_for(0.5)

    assert zensim.Recording(tmp_path / "run.mcap").counts["/r1/odom"] == count


def test_fork_that_steps_its_copy_of_the_world_writes_nothing(tmp_path: Path) -> None:
    with zensim.World() as world:
        world.spawn("box_bot", "r1")
        with world.record(tmp_path / "run.mcap") as recorder:
            world.run_for(1.0)
            child = os.fork()
            if child == 0:
                step_and_end(world)
            _, status = os.waitpid(child, 0)
            world.run_for(1.0)

    assert os.waitstatus_to_exitcode(status) == 0
    counts = recorder.read().counts
    assert counts == count_by_mcap(recorder.path)
    assert 155 <= counts["/r1/odom"] <= 165


def step_and_end(world: zensim.World) -> None:
    """Change and step a world; end the process without any more."""
    code = 1
    try:
        world.spawn("box_bot", "r2")
        world.run_for(2.0)
        code = 0
    finally:
        os._exit(code)


def test_time_that_a_snapshot_brings_back_begins_a_file(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    with zensim.World() as world:
        world.spawn("box_bot", "r1").drive(0.2)
        world.run_for(0.5)
        saved = world.snapshot()
        world.record(file, "*/odom")
        world.run_for(0.5)
        world.restore(saved)
        world.run_for(0.2)

    first, second = zensim.Recording(file), zensim.Recording(tmp_path / "run_1.mcap")
    assert first.end == pytest.approx(1.0, abs=1e-6)
    assert 0.5 <= second.start < second.end == pytest.approx(0.7, abs=0.02)


def test_existing_file_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "run.mcap"
    file.touch()
    with zensim.World() as world:
        with pytest.raises(zensim.Error) as refused:
            world.record(file)
        assert refused.value.slug == "no_recorder"
        with pytest.raises(zensim.Invalid):
            world.record(tmp_path / "other.mcap", rate=-1.0)


def test_full_disk_ends_the_recording_and_not_the_world(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "run.mcap"
    monkeypatch.setattr(recording_parts, "FLUSH_PERIOD_S", 0.0)  # space is checked at each step
    world = zensim.World()
    world.spawn("box_bot", "r1")
    recorder = world.record(file, "*/odom", "clock")
    world.run_for(2.0)

    def refuse(_parts: RecordingParts[object]) -> None:  # type: ignore[type-var]
        raise DiskFull("1 MiB is free")

    monkeypatch.setattr(RecordingParts, "_check_space", refuse)
    world.run_for(2.0)
    time = world.time
    with pytest.raises(zensim.Error) as failure:
        recorder.close()
    world.close()

    assert time == pytest.approx(4.0, abs=1e-6)
    assert failure.value.slug == "no_recorder"
    assert 0 < zensim.Recording(file).counts["/r1/odom"] < 320


def test_recording_with_a_relative_path_goes_on_when_the_directory_changes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(tmp_path)
    with zensim.World() as world:
        recorder = world.record("run.mcap", "clock")
        world.run_for(0.1)
        monkeypatch.chdir(elsewhere)
        world.reset()
        world.run_for(0.1)
        recording = recorder.read()

    assert recording.counts["/clock"] > 5
    assert sorted(one.name for one in tmp_path.iterdir() if one.is_file()) == [
        "metadata.yaml",
        "run.mcap",
        "run_1.mcap",
    ]
    assert list(elsewhere.iterdir()) == []
