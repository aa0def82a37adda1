"""Topics of a recording are chosen by name, and get the names that are asked for."""

from pathlib import Path

import pytest

from tests.recording.replays import write_run
from zensim.deploy.cli.replay_commands import expand_words
from zensim.proto.ros2.qos_profiles import RELIABLE_10
from zensim.recording.recording_reader import RecordingReader, StoredTopic
from zensim.recording.replay.replayed_names import NameSettings, ReplayedNames
from zensim.recording.topic_selection import TopicSelection

ALL = TopicSelection()


@pytest.fixture(scope="module")
def topics(tmp_path_factory: pytest.TempPathFactory) -> tuple[StoredTopic, ...]:
    path = tmp_path_factory.mktemp("run") / "run.mcap"
    write_run(path, 1.0)
    return RecordingReader(path).topics


def list_keys(topics: tuple[StoredTopic, ...], settings: NameSettings) -> set[str]:
    return set(ReplayedNames(settings, topics).keys.values())


def test_all_topics_but_the_clock_and_what_programs_exchange_are_replayed(
    topics: tuple[StoredTopic, ...],
) -> None:
    names = ReplayedNames(NameSettings(selection=ALL), topics)

    assert set(names.keys.values()) == {
        "r1/odom",
        "tf_static",
        "r1/robot_description",
        "r1/custom",
        "sim/default/events",
    }
    assert names.clock_key == "clock"


@pytest.mark.parametrize(
    ("selection", "wanted"),
    [
        (TopicSelection(topics=("/r1/odom", "tf_static")), {"r1/odom", "tf_static"}),
        (TopicSelection(regex="^/r1/c"), {"r1/custom"}),
        (TopicSelection(exclude_regex="sim|r1"), {"tf_static"}),
        (
            TopicSelection(topics=("*/*",), exclude_topics=("/*/custom",)),
            {"r1/odom", "r1/robot_description"},
        ),
    ],
)
def test_topics_are_chosen_as_rosbag2_does(
    topics: tuple[StoredTopic, ...], selection: TopicSelection, wanted: set[str]
) -> None:
    assert list_keys(topics, NameSettings(selection=selection)) == wanted


@pytest.mark.parametrize(
    ("rule", "wanted"),
    [
        ("/r1/odom:=/base/odometry", {"base/odometry", "r1/custom"}),
        ("/r1:=/team/ghost", {"team/ghost/odom", "team/ghost/custom"}),
        ("/r:=/x", {"r1/odom", "r1/custom"}),
    ],
)
def test_topics_and_names_above_them_are_renamed(
    topics: tuple[StoredTopic, ...], rule: str, wanted: set[str]
) -> None:
    chosen = TopicSelection(topics=("/r1/odom", "/r1/custom"))

    settings = NameSettings(selection=chosen, remaps=(rule,))

    assert list_keys(topics, settings) == wanted
    assert ReplayedNames(settings, topics).unused_rules == ({"r"} if rule == "/r:=/x" else set())


def test_namespace_stands_before_all_names_and_names_the_world(
    topics: tuple[StoredTopic, ...],
) -> None:
    names = ReplayedNames(NameSettings(selection=ALL, namespace="again/a"), topics)

    assert {"again/a/r1/odom", "again/a/tf_static", "sim/again_a/events"} <= set(
        names.keys.values()
    )
    assert names.clock_key == "again/a/clock"


@pytest.mark.parametrize(
    "settings",
    [
        NameSettings(selection=ALL, remaps=("/r1",)),
        NameSettings(selection=ALL, remaps=("/r1:=",)),
        NameSettings(selection=ALL, remaps=("/r1:=/sim",)),
        NameSettings(selection=ALL, namespace="a b"),
        NameSettings(selection=ALL, world="a/b"),
        NameSettings(selection=TopicSelection(topics=("/nothing",))),
        NameSettings(selection=TopicSelection(regex="(")),
    ],
)
def test_names_that_cannot_be_are_refused(
    topics: tuple[StoredTopic, ...], settings: NameSettings
) -> None:
    with pytest.raises(ValueError, match=r"use|valid|chosen"):
        ReplayedNames(settings, topics)


@pytest.mark.parametrize(
    ("words", "wanted"),
    [
        (["--clock"], ["--clock", "40"]),
        (["--clock", "100", "f"], ["--clock", "100", "f"]),
        (["--clock", "--loop"], ["--clock", "40", "--loop"]),
        (["f", "--topics", "/a", "/b"], ["f", "--topics", "/a", "--topics", "/b"]),
        (["-m", "/a:=/b", "/c:=/d", "f"], ["-m", "/a:=/b", "-m", "/c:=/d", "f"]),
    ],
)
def test_words_of_rosbag2_are_understood(words: list[str], wanted: list[str]) -> None:
    assert expand_words(words) == wanted


def test_file_after_topics_is_no_topic(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    path.touch()

    assert expand_words(["--topics", "/a", str(path)]) == ["--topics", "/a", str(path)]


HOSTILE_NAMES = (
    "/**",
    "/*/cmd_vel",
    "/r1/cmd_vel?x=1",
    "/r1/$*/odom",
    "/r1//odom",
    "sim/default/events/x",
    "//sim/default/spawn",
    "/sim/**/events",
    "/sim/default",
    "/r1/a b",
    "/r1/#",
    "/",
    "",
    "/" + "a/" * 200 + "odom",
)


def test_names_that_are_no_topics_are_left_out_and_named() -> None:
    topics = [make_stored(name) for name in ("/r1/odom", *HOSTILE_NAMES)]

    names = ReplayedNames(NameSettings(selection=ALL), topics)
    chosen = ReplayedNames(NameSettings(selection=TopicSelection(topics=("/r1/odom",))), topics)

    assert set(names.keys.values()) == set(chosen.keys.values()) == {"r1/odom"}
    are_of_a_world = {"sim/default/events/x", "//sim/default/spawn", "/sim/default"}
    assert set(names.left_out) == set(HOSTILE_NAMES) - are_of_a_world
    assert names.world == "default"


@pytest.mark.parametrize("name", ["sim/old/events", "//sim/old/events", "/sim/old/events/"])
def test_topics_of_a_world_are_found_with_and_without_slashes(name: str) -> None:
    names = ReplayedNames(
        NameSettings(selection=ALL, namespace="ghost"), [make_stored(name), make_stored("/x")]
    )

    assert set(names.keys.values()) - {"sim/ghost/events"} == {"ghost/x"}


def make_stored(name: str) -> StoredTopic:
    return StoredTopic(
        name, "std_msgs/msg/String", "cdr", "", b"", {}, RELIABLE_10, is_latched=False
    )
