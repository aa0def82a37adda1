"""Warnings and errors of a program on `/rosout`."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from tests.fakes import ManualClock, MemoryBus
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.standard_messages import ns_from_time
from zensim.proto.ros2.node_messages import LogLevel, RosoutLog
from zensim.proto.ros2.rmw_attachment import read_attachment
from zensim.proto.ros2.ros_graph import RosGraph
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.rosout import (
    BURST,
    FOR_OPERATORS,
    MAX_TEXT,
    MAX_WAITING,
    RATE_HZ,
    ROSOUT,
    LogCollector,
    Rosout,
)

LOG = logging.getLogger("zensim.sim_server.test")
KEY = "0/rosout/rcl_interfaces::msg::dds_::Log_/*"


class Program:
    """A program with a node `/team/r1/agent`, and a subscriber of `/rosout`."""

    def __init__(self, settings: RosSettings = RosSettings()) -> None:  # noqa: B008
        self.bus = MemoryBus()
        self.graph = RosGraph(self.bus, settings)
        self.node = self.graph.add_node("team/r1", "agent")
        self.clock = ManualClock()
        self.rosout = Rosout(self.bus, self.graph, now_s=self.clock)
        self.subscription = self.bus.subscribe(KEY, 4096)

    def read(self) -> list[RosoutLog]:
        self.rosout.poll()
        return [decode(RosoutLog, one.payload, one.encoding) for one in self.subscription.take()]

    def read_late(self) -> list[str]:
        self.bus.pumps.append(self.rosout.poll)
        found = self.bus.ask(f"{KEY}/@adv/**", b"", b"")
        assert all(read_attachment(one.attachment) for one in found)
        return [decode(RosoutLog, one.payload, one.encoding).msg for one in found]


@contextmanager
def running(settings: RosSettings = RosSettings()) -> Iterator[Program]:  # noqa: B008
    program = Program(settings)
    try:
        yield program
    finally:
        program.rosout.close()


@pytest.fixture
def program() -> Iterator[Program]:
    with running() as found:
        yield found


def test_warning_is_published_with_its_node_place_and_wall_time(program: Program) -> None:
    LOG.warning("body=%d refused", 3)

    (log,) = program.read()

    assert (log.level, log.name, log.msg) == (LogLevel.WARN, "team.r1.agent", "body=3 refused")
    assert (log.file.rpartition("/")[2], log.function) == (
        "test_rosout.py",
        "test_warning_is_published_with_its_node_place_and_wall_time",
    )
    assert log.line > 0
    assert ns_from_time(log.stamp) > 1_600_000_000 * 10**9


def test_file_is_named_from_the_package_on(program: Program) -> None:
    record = logging.LogRecord(
        "a", logging.ERROR, "/home/me/zensim/lib/zensim/proto/bus.py", 7, "x", None, None
    )
    collector = LogCollector()
    collector.handle(record)

    Rosout(program.bus, program.graph, collector).poll()

    (log,) = program.read()
    assert (log.file, log.line) == ("zensim/proto/bus.py", 7)


def test_error_names_its_exception(program: Program) -> None:
    LOG.error("request failed", exc_info=ValueError("no such body"))

    (log,) = program.read()

    assert (log.level, log.msg) == (LogLevel.ERROR, "request failed: ValueError: no such body")


def test_text_is_short_and_printable(program: Program, monkeypatch: pytest.MonkeyPatch) -> None:
    # Workers of pytest cannot send a captured log with a lone surrogate.
    monkeypatch.setattr(logging.getLogger(), "handlers", [])
    LOG.critical("\x1b[2J \ud800 %s", "x" * 2 * MAX_TEXT)

    (log,) = program.read()

    assert log.level == LogLevel.FATAL
    assert log.msg.startswith("\\u001b[2J \\ud800 xx")
    assert len(log.msg) < MAX_TEXT + 16


def test_arguments_that_do_not_fit_are_left_out(
    program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(logging, "raiseExceptions", False)
    LOG.log(logging.WARNING, *("%d of %d", "one"))

    assert [one.msg for one in program.read()] == ["%d of %d"]


def test_notes_and_lines_for_operators_are_not_published(program: Program) -> None:
    LOG.info("serving")
    LOG.warning("refused user=%s", "eve", extra=FOR_OPERATORS)

    assert program.read() == []


def test_late_subscriber_gets_earlier_lines_in_order(program: Program) -> None:
    LOG.warning("first")
    LOG.error("second")
    program.read()

    assert program.read_late() == ["first", "second"]


def test_endpoint_has_the_profile_and_the_token_of_rcl(program: Program) -> None:
    program.rosout.poll()

    (endpoint,) = program.bus.list_tokens("@ros2_lv/0/*/*/*/MP/**")
    assert endpoint.endswith("/:1:,1000:,:10,0:,,")
    assert program.bus.list_tokens(f"{KEY}/@adv/pub/{program.bus.zid}/uhlc/_")


def test_flood_is_limited_and_its_rest_is_counted(program: Program) -> None:
    for number in range(2 * MAX_WAITING):
        LOG.warning("line %d", number)

    first = program.read()
    program.clock.sleep(1.0)
    second = program.read()
    program.clock.sleep(60.0)
    rest = program.read()

    assert (len(first), len(second)) == (BURST, RATE_HZ)
    assert [one.msg for one in (*first, *second)] == [f"line {n}" for n in range(BURST + RATE_HZ)]
    assert rest[-1].msg.startswith(f"{MAX_WAITING} further ")


def test_what_publishing_logs_is_not_published(
    program: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    program.rosout.poll()
    before = program.bus.stamp

    def stamp() -> object:
        LOG.warning("of the publication itself")
        return before()

    monkeypatch.setattr(program.bus, "stamp", stamp)
    LOG.warning("first")

    assert [one.msg for one in program.read()] == ["first"]
    assert program.read() == []


def test_another_node_publishes_when_the_first_has_left(program: Program) -> None:
    assert program.node is not None
    LOG.warning("first")
    program.read()
    program.graph.add_node("", "zensim_pool_1")

    program.node.close()
    LOG.warning("second")

    assert [one.name for one in program.read()] == ["zensim_pool_1"]
    assert program.read_late() == ["first", "second"]


def test_lines_wait_for_the_first_node(program: Program) -> None:
    assert program.node is not None
    program.node.close()
    LOG.warning("early")
    assert program.read() == []

    program.graph.add_node("", "zensim")

    assert [one.msg for one in program.read()] == ["early"]


def test_bridge_gets_lines_on_the_plain_key() -> None:
    with running(RosSettings(is_bridged=True)) as bridged:
        plain = bridged.bus.subscribe(ROSOUT.key, 8)
        LOG.warning("first")
        bridged.rosout.poll()

        assert len(plain.take()) == 1


def test_lines_of_the_end_are_published(program: Program) -> None:
    program.rosout.poll()
    LOG.error("journal not written")

    program.rosout.close()
    LOG.error("too late")

    assert [one.msg for one in program.read()] == ["journal not written"]


def test_program_without_ros_collects_nothing() -> None:
    before = logging.getLogger("zensim").handlers[:]

    with running(NO_ROS) as program:
        assert logging.getLogger("zensim").handlers == before
        LOG.warning("first")
        assert program.read() == []
