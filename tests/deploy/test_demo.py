"""`zensim up` tells its server what it was told itself, and nothing else."""

import msgspec

from deploy.demo import DemoConfig, serve_arguments

PLAIN = DemoConfig(
    places=(),
    model="box_bot",
    world="w.world",
    world_name="default",
    endpoint="tcp/127.0.0.1:1",
    has_viewer=False,
    viewer_port=0,
)
JOINING = ("serve", "--listen", "tcp/127.0.0.1:1", "--world", "w.world", "--world-name", "default")


def test_pace_is_left_to_the_world_unless_asked_for() -> None:
    hasty = msgspec.structs.replace(PLAIN, real_time_factor=0.0)

    assert serve_arguments(PLAIN) == JOINING
    assert serve_arguments(hasty) == (*JOINING, "--rtf", "0.0")


def test_server_waits_for_agents_when_told_to() -> None:
    locked = msgspec.structs.replace(PLAIN, is_lockstep=True)

    assert serve_arguments(locked) == (*JOINING, "--lockstep")


def test_server_looks_where_it_is_told_to() -> None:
    config = msgspec.structs.replace(PLAIN, model_paths=("a", "b c"), is_strict=True)

    paths = ("--model-path", "a", "--model-path", "b c", "--strict")
    assert serve_arguments(config) == (*JOINING, *paths)
