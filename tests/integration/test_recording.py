"""`zensim record` beside a running world, and what independent readers find in its files."""

import json
import signal
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import psutil
import pytest
from rosbags.highlevel import AnyReader

import zensim as api
from tests.integration.processes import eventually, kill, read_json_line, run_in_process, running
from tests.integration.processes import zensim as run_zensim
from tests.recording.recordings import count_by_mcap, count_by_rosbags
from zensim.api.recorder_process import RecorderProcess
from zensim.deploy.cli.record_commands import RecordProgram
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import decode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.topic_catalog import INPUTS, TF
from zensim.recording import fleet_robots
from zensim.recording.recorder import RecorderSettings
from zensim.recording.recording_parts import PartSettings
from zensim.recording.recording_reader import RecordingReader
from zensim.recording.recording_session import SessionSettings
from zensim.recording.topic_selection import TopicFilter, TopicSelection

if TYPE_CHECKING:
    import subprocess

LEAST = 20
"""Messages of a topic until a test goes on."""
WITHIN_S = 30.0


@pytest.fixture(scope="module")
def sim() -> Iterator[api.Sim]:
    with api.launch(engine="mujoco", timeout_s=120.0) as sim:
        sim.spawn("box_bot", name="r1")
        sim.play()
        yield sim


@pytest.fixture
def bus(sim: api.Sim) -> Iterator[Bus]:
    with open_bus(BusConfig(connect=(sim.endpoint,))) as bus:
        yield bus


def end_recording(process: "subprocess.Popen[str]") -> dict[str, object]:
    """End a recorder as Ctrl-C does; return what it says."""
    process.send_signal(signal.SIGINT)
    figures = read_json_line(process)
    assert process.wait(WITHIN_S) == ExitCode.OK
    return figures


def wait_for_messages(bus: Bus, key: str, count: int) -> list[bytes]:
    """Wait until this number of messages was published on a key."""
    subscription = bus.subscribe(key, 65536)
    payloads: list[bytes] = []

    def has_enough() -> bool:
        payloads.extend(one.payload for one in subscription.take())
        return len(payloads) >= count

    eventually(has_enough, WITHIN_S, f"{count} messages on {key}")
    subscription.close()
    return payloads


def test_recording_has_the_bytes_of_the_network_and_of_robots_that_appear(
    sim: api.Sim, bus: Bus, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    with running(
        "record", "--all", "-o", str(path), "--connect", sim.endpoint, "--json"
    ) as process:
        read_json_line(process)
        payloads = wait_for_messages(bus, "r1/odom", LEAST)
        robot = sim.spawn("box_bot", name="r2")
        wait_for_messages(bus, "r2/odom", LEAST)
        robot.delete()
        wait_for_messages(bus, "r1/odom", LEAST)
        figures = end_recording(process)

    counts = count_by_mcap(path)
    assert counts == count_by_rosbags(path)
    assert figures["messages"] == sum(counts.values())
    assert (figures["lost"], figures["overflows"], figures["malformed"]) == (0, 0, 0)
    assert counts["/r2/odom"] >= LEAST
    assert {"/clock", "/sim/default/events", "/r1/tf_static", "/r2/robot_description"} <= set(
        counts
    )
    with AnyReader([path]) as reader:
        odometry = [one for one in reader.connections if one.topic == "/r1/odom"]
        recorded = {raw for _, _, raw in reader.messages(connections=odometry)}
        texts = [one for one in reader.connections if one.topic == "/sim/default/events"]
        events = [
            json.loads(vars(reader.deserialize(raw, one.msgtype))["data"])
            for one, _, raw in reader.messages(connections=texts)
        ]
    assert set(payloads) <= recorded
    assert ("spawned", "r2") in [(one["kind"], one["entity"]) for one in events]


def test_killed_recording_is_read_and_recovered(sim: api.Sim, tmp_path: Path) -> None:
    path, target = tmp_path / "run.mcap", tmp_path / "whole.mcap"
    with running("record", "*/odom", "-o", str(path), "--connect", sim.endpoint) as process:
        eventually(lambda: has_messages(path), WITHIN_S, "a chunk")
        kill(process.pid, signal.SIGKILL)
        process.wait()

    info = run_zensim("bag", "info", str(path), "--json")
    recovered = run_zensim("bag", "recover", str(path), "-o", str(target), "--json")

    assert "never closed" in info.stderr
    messages = json.loads(info.stdout)["messages"]
    assert messages == json.loads(recovered.stdout)["messages"] > 0
    assert sum(count_by_rosbags(target).values()) == messages


def has_messages(path: Path) -> bool:
    """Whether a file has whole chunks with messages; attached files are before them."""
    with suppress(api.Error):
        return any(api.Recording(path).counts.values())
    return False


def test_reset_begins_a_file_and_a_snapshot_is_written_on_an_event(
    sim: api.Sim, bus: Bus, tmp_path: Path
) -> None:
    folder, snapshot = tmp_path / "run", tmp_path / "last.mcap"
    options = ("--connect", sim.endpoint, "--json")
    ring = ("--snapshot-mode", "--snapshot-on", "spawned")
    with (
        running("record", "-e", "/odom$|^/clock$", "-o", str(folder), *options) as process,
        running("record", "/r1/odom", "-o", str(snapshot), *ring, *options) as ringing,
    ):
        read_json_line(process)
        read_json_line(ringing)
        wait_for_messages(bus, "r1/odom", LEAST)
        sim.spawn("box_bot", name="r3")
        wait_for_messages(bus, "r3/odom", LEAST)
        sim.reset()
        sim.spawn("box_bot", name="r1")
        wait_for_messages(bus, "r1/odom", LEAST)
        end_recording(process)
        figures = end_recording(ringing)

    assert sorted(one.name for one in folder.iterdir()) == [
        "metadata.yaml",
        "run_0.mcap",
        "run_1.mcap",
    ]
    assert set(count_by_mcap(folder / "run_1.mcap")) >= {"/r1/odom", "/clock"}
    # An event after the reset may lead to a second file.
    written = [sum(count_by_mcap(one).values()) for one in tmp_path.glob("last*.mcap")]
    assert figures["messages"] == sum(written) >= LEAST


def test_rate_keeps_the_newest_of_each_topic_and_all_events(
    sim: api.Sim, bus: Bus, tmp_path: Path
) -> None:
    path = tmp_path / "thin.mcap"
    options = ("--connect", sim.endpoint, "--json", "--rate", "5", "-o", str(path))
    with running("record", "--all", *options) as process:
        read_json_line(process)
        began = len(wait_for_messages(bus, "r1/odom", 1))
        for number in range(3):
            sim.spawn("box_bot", name=f"thin{number}")
        whole = len(wait_for_messages(bus, "r1/odom", 100)) + began
        figures = end_recording(process)

    reader = RecordingReader(path)
    stamps = [log_ns for _, log_ns, _, _ in reader.messages(lambda one: one.name == "/r1/odom")]
    counts = count_by_mcap(path)
    assert figures["lost"] == figures["overflows"] == 0
    assert 0 < len(stamps) < whole / 4
    assert max(Counter(stamp // 200_000_000 for stamp in stamps[:-1]).values()) <= 2
    assert counts["/sim/default/events"] >= 3
    assert counts["/thin2/tf_static"] >= 1


def test_large_fleets_are_thinned_by_the_messages_of_their_agents(
    bus: Bus, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(fleet_robots, "LEAST_ROBOTS", 1)
    wait_for_messages(bus, "r1/odom", 1)
    path, topics = tmp_path / "run.mcap", ("r1/odom", "r1/tf")
    subscriptions = {f"/{key}": bus.subscribe(key, 65536) for key in topics}
    wait_for_messages(bus, "r1/tf", 1)
    program = RecordProgram(
        bus,
        TopicFilter(TopicSelection(topics=("*/odom", "*/tf"))),
        RecorderSettings(world="default", domain=None, period_ns=200_000_000),
        SessionSettings(parts=PartSettings(path=path), max_cache_bytes=1 << 20),
    )

    program.run(lambda: False, 4.0)

    found: dict[str, list[bytes]] = {}
    for topic, _, _, payload in RecordingReader(path).messages():
        found.setdefault(topic.name, []).append(payload)
    published = {topic: [s.payload for s in one.take()] for topic, one in subscriptions.items()}
    assert 5 <= len(found["/r1/odom"]) <= len(published["/r1/odom"]) / 4
    assert set(found["/r1/odom"]) <= set(published["/r1/odom"])
    # An agent of one robot has no arrays, whose sines may end in another bit.
    by_stamp = {one[8:16]: decode(TFMessage, one, TF.encoding) for one in published["/r1/tf"]}
    assert len(found["/r1/tf"]) == len(found["/r1/odom"])
    for payload in found["/r1/tf"]:
        assert_close(decode(TFMessage, payload, TF.encoding), by_stamp[payload[8:16]])


def assert_close(found: TFMessage, expected: TFMessage) -> None:
    for one, other in zip(found.transforms, expected.transforms, strict=True):
        assert one.header == other.header
        assert one.child_frame_id == other.child_frame_id
        for field in ("translation", "rotation"):
            numbers, others = (
                msgspec.structs.astuple(getattr(edge.transform, field)) for edge in (one, other)
            )
            assert numbers == pytest.approx(others, abs=1e-12)


def test_recording_says_what_is_wrong(sim: api.Sim, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()
    at = ("--connect", sim.endpoint)

    nothing = run_zensim("record", *at)
    exists = run_zensim("record", "-a", "-o", str(path), *at)
    storage = run_zensim("record", "-a", "-s", "sqlite3", *at)
    kept = run_in_process("record", "-a", "--keep-last", "10 years", *at)
    times = run_in_process("record", "-a", "--reproducible", "--log-time", "wall", *at)

    absent = run_zensim(
        *("record", "-e", "^r0/odom$", "--duration", "1", "-o", str(tmp_path / "no.mcap"), *at)
    )
    with pytest.raises(api.Error) as refused:
        sim.record(path, "*/odom")

    assert (absent.returncode, absent.stderr.count("record: note: ")) == (ExitCode.OK, 1)
    assert "run.mcap" in str(refused.value)
    assert "{" not in str(refused.value)
    assert nothing.returncode == ExitCode.USAGE
    assert exists.returncode == ExitCode.FAILED
    assert [one.returncode for one in (storage, kept, times)] == [ExitCode.USAGE] * 3
    assert "mcap" in storage.stderr


def test_recording_is_whole_whatever_ends_its_loop(bus: Bus, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    program = RecordProgram(
        bus,
        TopicFilter(TopicSelection(topics=("*/odom",))),
        RecorderSettings(world="default", domain=None),
        SessionSettings(parts=PartSettings(path=path), max_cache_bytes=1 << 20),
    )
    ends_s = time.monotonic() + 1.0

    def fail_late() -> bool:
        if time.monotonic() > ends_s:
            raise RuntimeError("unexpected")
        return False

    with pytest.raises(RuntimeError):
        program.run(fail_late, 0.0)

    assert RecordingReader(path).unclosed == ()
    assert sum(count_by_rosbags(path).values()) > 0


def test_recorder_that_finds_no_clock_leaves_no_file(bus: Bus, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"

    with pytest.raises(BusError):
        RecordProgram(
            bus,
            TopicFilter(TopicSelection(wants_all=True)),
            RecorderSettings(world="elsewhere", domain=None),
            SessionSettings(parts=PartSettings(path=path), max_cache_bytes=1 << 20),
        )

    assert list(tmp_path.iterdir()) == []


def test_recording_has_the_requests_of_the_server(sim: api.Sim, bus: Bus, tmp_path: Path) -> None:
    path, topic = tmp_path / "run.mcap", "/sim/default/requests"
    with sim.record(path, topic, timeout_s=90.0):
        wait_for_messages(bus, INPUTS.key("default"), 1)  # a log that has begun
        sim.spawn("box_bot", name="asked").delete()
        found = eventually(
            lambda: find_requests(path, topic) or None, WITHIN_S, "requests in the file"
        )

    assert found["spawn_entity"]["name"] == found["delete_entity"]["entity"] == "asked"


def find_requests(path: Path, topic: str) -> dict[str, dict[str, object]]:
    """Find the last request of each service in a file, once entities were spawned and deleted."""
    recording = api.Recording(path)
    if not recording.counts.get(topic):
        return {}
    texts = [json.loads(one.data.data) for one in recording.messages(topic)]  # type: ignore[attr-defined]
    found = {one["service"]: one["request"] for one in texts}
    return found if {"spawn_entity", "delete_entity"} <= set(found) else {}


def test_recorder_that_was_killed_is_an_error(sim: api.Sim, tmp_path: Path) -> None:
    recorder = sim.record(tmp_path / "run.mcap", "*/odom", timeout_s=90.0)
    assert isinstance(recorder, RecorderProcess)
    (process,) = [
        one
        for one in psutil.Process().children(recursive=True)
        if str(recorder.path) in one.cmdline()
    ]
    process.kill()
    eventually(lambda: process.status() == psutil.STATUS_ZOMBIE, WITHIN_S, "its end")

    with pytest.raises(api.Error) as failure:
        recorder.close()
    assert failure.value.slug == "no_recorder"
