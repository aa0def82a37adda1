"""What is in the file of a recording: that of a whole deployment, and every bit of a burst."""

import hashlib
import json
import random
import signal
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.processes import (
    Server,
    eventually,
    free_endpoint,
    read_json_line,
    running,
    serving,
)
from tests.integration.processes import zensim as run_zensim
from tests.node_peers.node_packages import FOLDER, run_script
from tests.recording.recordings import count_by_mcap, count_by_rosbags
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.exit_codes import ExitCode
from zensim.proto.messages.standard_messages import Header, Odometry, Time
from zensim.proto.topic_catalog import ODOM
from zensim.recording.bag_info import read_info
from zensim.recording.recording_reader import RecordingReader

WITHIN_S = 60.0
MESSAGES, IN_A_BURST = 10_000, 500
TOO_MUCH = "900000GB"
"""Free space that no disk has."""


@pytest.fixture
def server() -> Iterator[Server]:
    with serving("--engine", "mujoco") as server:
        yield server


def test_file_of_a_deployment_is_read_alike_by_four_readers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    path, listen = tmp_path / "run.mcap", free_endpoint()
    options = ("--robots", "10", "--behaviour", "circle", "--engine", "mujoco", "--no-viewer")
    with running("up", *options, "--listen", listen, "--record", str(path), "--json") as process:
        read_json_line(process)
        eventually(lambda: path.exists() and path.stat().st_size > 200_000, WITHIN_S, "recording")
        process.send_signal(signal.SIGINT)
        process.wait(WITHIN_S)

    counts = count_by_mcap(path)
    found = json.loads(run_script(FOLDER / "read_mcap.cjs", str(path)))
    by_node = {name: topic["count"] for name, topic in found["topics"].items() if topic["count"]}
    assert counts == count_by_rosbags(path) == by_node
    assert counts == {one.name: one.messages for one in read_info(path).topics if one.messages}
    assert {f"/box_bot{number}/odom" for number in range(10)} <= counts.keys()
    assert {"/clock", "/sim/default/inputs", "/sim/default/stats"} <= counts.keys()


def test_ten_thousand_messages_have_the_bits_that_were_published(
    server: Server, tmp_path: Path
) -> None:
    path, draws = tmp_path / "run.mcap", random.Random(5)
    with (
        running(
            *("record", "*/odom", "-o", str(path), "--connect", server.endpoint, "--json")
        ) as process,
        open_bus(BusConfig(connect=(server.endpoint,))) as listener,
    ):
        read_json_line(process)
        published = publish_burst(server.bus, listener, draws)
        process.send_signal(signal.SIGINT)
        figures = read_json_line(process)
        process.wait(WITHIN_S)

    recorded = Counter(
        digest(topic.name, payload) for topic, _, _, payload in RecordingReader(path).messages()
    )
    # A queue that was exactly full counts as overflown, also if nothing came after it.
    assert (figures["lost"], figures["messages"]) == (0, MESSAGES)
    assert recorded == published


def publish_burst(bus: Bus, listener: Bus, draws: random.Random) -> Counter[str]:
    """Publish as fast as another subscriber takes it; return the digests of what was sent."""
    subscription = listener.subscribe("*/odom", MESSAGES)
    topics = [ODOM.key(f"burst{number}") for number in range(4)]
    publishers = [bus.advertise(key, ODOM.encoding) for key in topics]
    eventually(lambda: all(one.is_matched for one in publishers), WITHIN_S, "subscribers")
    sent: Counter[str] = Counter()
    received = 0

    def has_all() -> bool:
        nonlocal received
        received += len(subscription.take())
        return received == sent.total()

    for number in range(MESSAGES):
        payload = make_payload(number, draws)
        publishers[number % len(topics)].send(payload)
        sent[digest(f"/{topics[number % len(topics)]}", payload)] += 1
        if sent.total() % IN_A_BURST == 0:
            eventually(has_all, WITHIN_S, "all messages")
    return sent


def make_payload(number: int, draws: random.Random) -> bytes:
    """Make odometry with random bits behind its stamp."""
    payload = bytearray(encode(Odometry(Header(Time(0, number), "odom"), "base"), Format.CDR))
    payload[-64:] = draws.randbytes(64)
    return bytes(payload)


def digest(topic: str, payload: bytes) -> str:
    return hashlib.sha256(topic.encode() + b"\0" + payload).hexdigest()


def test_world_goes_on_when_a_recording_ends_for_want_of_space(
    server: Server, tmp_path: Path
) -> None:
    path = tmp_path / "run.mcap"
    options = ("-o", str(path), "--connect", server.endpoint, "--min-free", TOO_MUCH)

    done = run_zensim("record", "--all", *options)
    before = server.steps()

    assert done.returncode == ExitCode.FAILED
    assert done.stderr.count("min-free") == 1
    assert not read_info(path).unclosed
    assert sum(count_by_mcap(path).values()) == sum(t.messages for t in read_info(path).topics)
    eventually(lambda: server.steps() > before, WITHIN_S, "steps")
