"""Key expressions, built and parsed."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto import keys
from zensim.proto.names import NAME_PATTERN
from zensim.proto.topic_catalog import (
    CLOCK,
    CMD_VEL,
    DRIVE_COMMAND,
    DRIVE_STATE,
    EVENTS,
    SNAPSHOT,
    STATS,
)

NAMES = st.from_regex(NAME_PATTERN, fullmatch=True)


@pytest.mark.parametrize(
    ("key", "expected"),
    [
        (keys.service("default", "spawn_entity"), "sim/default/spawn_entity"),
        (keys.services("default"), "sim/default/*"),
        (CLOCK.key("default"), "sim/default/clock"),
        (STATS.key("default"), "sim/default/stats"),
        (SNAPSHOT.key("default"), "sim/default/snapshot"),
        (EVENTS.key("default"), "sim/default/events"),
        (DRIVE_STATE.key("default", "a1"), "sim/default/drive/a1/state"),
        (DRIVE_COMMAND.key("default", "a1"), "sim/default/drive/a1/command"),
        (DRIVE_COMMAND.key("default", "*"), "sim/default/drive/*/command"),
        (keys.alive_server("default"), "sim/default/alive/server"),
        (keys.alive_agent("default", "a1"), "sim/default/alive/agent/a1"),
        (keys.alive_agents("default"), "sim/default/alive/agent/*"),
        (CMD_VEL.key("team/r1"), "team/r1/cmd_vel"),
    ],
)
def test_key_has_its_documented_form(key: str, expected: str) -> None:
    assert key == expected


@given(world=NAMES, agent=NAMES)
def test_agent_is_parsed_from_drive_and_alive_keys(world: str, agent: str) -> None:
    assert keys.parse_agent(DRIVE_STATE.key(world, agent)) == agent
    assert keys.parse_agent(DRIVE_COMMAND.key(world, agent)) == agent
    assert keys.parse_agent(keys.alive_agent(world, agent)) == agent


@pytest.mark.parametrize(
    "key",
    [
        "",
        CLOCK.key("default"),
        keys.alive_server("default"),
        "sim/default/alive/viewer/a1",
        "sim/default/other/a1/state",
        "sim/default/drive/a1/state/more",
    ],
)
def test_agent_of_another_key_is_empty(key: str) -> None:
    assert keys.parse_agent(key) == ""


@pytest.mark.parametrize(
    ("key", "chunk"), [("sim/default/clock", "clock"), ("r1/odom", "odom"), ("odom", "odom")]
)
def test_last_chunk_is_the_end_of_a_key(key: str, chunk: str) -> None:
    assert keys.last_chunk(key) == chunk
