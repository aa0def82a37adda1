"""Snapshots that were altered by somebody who knows their form: nothing of them is run."""

import copy
import gc
import os
import pickle
import random
import sys
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any

import msgspec
import pytest

from zensim import Invalid, Unsupported, World
from zensim.api.world_snapshots import DIGEST_BYTES
from zensim.proto.messages.standard_messages import LaserScan

SHORT_MUTANTS, MUTANTS = 300, 10_000
MAX_EDITS = 4
FORBIDDEN = ("os.", "subprocess.", "shutil.", "socket.", "ctypes.", "pickle.", "exec", "compile")
"""What no restore does, by the beginning of the names of audit events."""
HARMLESS = ("os.listdir",)
"""What the import of a module that was not needed before does."""
Parts = dict[bytes, bytes]
LONG = pytest.mark.timeout(3600)


def _seal(header: bytes, body: bytes) -> bytes:
    """Write a checksum, as whoever alters a snapshot would."""
    checksum = blake2b(body, digest_size=DIGEST_BYTES).hexdigest().encode()
    return b"\n".join([header, checksum, body])


def _open(snapshot: bytes) -> tuple[bytes, Parts, list[Any]]:
    """Split a snapshot: header, shared parts, and the list of layouts, arrays and the root."""
    header, _, body = snapshot.split(b"\n", 2)
    parts, graph = msgspec.msgpack.decode(body)
    return header, parts, msgspec.msgpack.decode(graph)


def _close(header: bytes, parts: Parts, graph: list[Any]) -> bytes:
    encode = msgspec.msgpack.encode
    return _seal(header, encode([parts, encode(graph)]))


class SeenEvents:
    """Events of the interpreter that show that something was run, while they are watched."""

    def __init__(self) -> None:
        self.seen: list[str] = []
        self._is_watching = False
        sys.addaudithook(self._note)

    def _note(self, event: str, arguments: tuple[Any, ...]) -> None:
        if not self._is_watching or "libEGL" in str(arguments):  # the renderer of sensors
            return
        if event.startswith(FORBIDDEN) and event not in HARMLESS:
            self.seen.append(f"{event} {arguments!r}"[:200])
        if event == "open" and "w" in str(arguments[1]):
            self.seen.append(f"{event} {arguments!r}"[:200])

    @contextmanager
    def watched(self) -> Iterator[list[str]]:
        """Watch a block."""
        self.seen, self._is_watching = [], True
        try:
            yield self.seen
        finally:
            self._is_watching = False


EVENTS = SeenEvents()


@pytest.fixture(scope="module")
def world() -> Iterator[World]:
    with World("walls", seed=3) as made:
        robot = made.spawn("box_bot_lidar", name="r1")
        made.spawn("car_bot", name="r2", y=2.0)
        robot.on("scan")(_ignore)
        robot.drive(0.3, 0.1)
        made.inject("r1", "sensor_noise", "lidar", value=0.1, seconds=1.2)
        made.run_for(0.4)
        yield made


def _ignore(_: LaserScan) -> None:
    """Take a scan, so that the sensor is measured."""


class _Attack:
    def __init__(self, path: Path) -> None:
        self._path = path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return os.system, (f"touch {self._path}",)


def test_snapshot_that_is_a_pickle_is_refused_and_not_run(world: World, tmp_path: Path) -> None:
    python = ".".join(map(str, sys.version_info[:2]))
    body = pickle.dumps(({}, None)) + pickle.dumps(_Attack(tmp_path / "was_run"))
    former = f"zensim-snapshot {version('zensim')} {python} mujoco".encode()
    crafted = b"\n".join([former, b"%08x" % zlib.crc32(body), body])

    with pytest.raises(Invalid) as refused:
        world.restore(crafted)

    assert refused.value.slug == "wrong_snapshot"
    assert not (tmp_path / "was_run").exists()


@pytest.mark.parametrize(
    ("layouts", "root"),
    [
        ([], ["found", "os:system", "true"]),
        ([], ["found", "builtins:eval", "1"]),
        ([], ["function", "os:system"]),
        ([], ["function", "numpy:load"]),
        ([], ["partial", ["function", "os:system"], ["tuple", "true"], ["dict"]]),
        ([["subprocess:Popen", "args"]], ["object", 0, "true"]),
        ([["zensim.api.in_process_world:World"]], ["object", 0]),
        ([["zensim.proto.child_process:ChildProcess"]], ["object", 0]),
        ([["zensim.api.world_host:sys"]], ["class", 0]),
        ([], ["method", "system", ["fixed", "world"]]),
        ([], ["method", "save", ["fixed", "world"]]),
        ([["zensim.sim_server.world.entity_store:EntityStore", "find"]], ["object", 0, 1]),
        ([["zensim.sim_server.world.entity_store:EntityStore", "__class__"]], ["object", 0, 1]),
        ([], ["array", 0, b""]),
        ([], ["again", 0]),
        ([], ["tuple", ["again", 0]]),
        ([], ["fixed", "unknown"]),
        ([], ["shared", b"0" * DIGEST_BYTES]),
        ([], ["unknown"]),
        ([], []),
        ([], {"a": 1}),
        ([], 1),
        ([], ["list", *[["list"]] * 1000]),
    ],
)
def test_snapshot_that_names_what_no_state_has_is_refused(
    world: World, layouts: list[list[str]], root: object
) -> None:
    header, parts, _ = _open(world.snapshot())
    before = world.state_hash()

    with EVENTS.watched() as seen, pytest.raises(Invalid) as refused:
        world.restore(_close(header, parts, [layouts, [], root]))

    assert refused.value.slug == "wrong_snapshot"
    assert seen == []
    assert world.state_hash() == before


@pytest.mark.parametrize("kind", ["|O", "V8", "U8", "<f8,<f8", "O", ""])
def test_snapshot_with_arrays_of_objects_is_refused(world: World, kind: str) -> None:
    header, parts, (layouts, _, _) = _open(world.snapshot())
    graph = [layouts, [[kind, [1], "C", True]], ["array", 0, bytes(8)]]
    with pytest.raises(Invalid):
        world.restore(_close(header, parts, graph))


def test_shared_part_with_the_digest_of_another_is_refused() -> None:
    with World() as world, World() as other:
        world.spawn("box_bot", name="r1")
        header, parts, graph = _open(world.snapshot())
        first, second = sorted(parts)[:2]
        fresh = bytes(DIGEST_BYTES)
        swapped = {**parts, fresh: parts[second]}
        text = msgspec.msgpack.encode(graph).replace(first, fresh)
        assert fresh in text

        with pytest.raises(Invalid):
            other.restore(_close(header, swapped, msgspec.msgpack.decode(text)))


def test_state_of_bullet_is_restored_only_if_it_is_as_this_world_wrote_it() -> None:
    with World(engine="pybullet") as world:
        world.spawn("box_bot", name="r1")
        header, _, body = world.snapshot().split(b"\n", 2)
        with pytest.raises(Invalid) as refused:
            world.restore(_seal(header, body))
        assert refused.value.slug == "wrong_snapshot"


def _edit_bytes(data: bytes, choose: random.Random) -> bytes:
    """Change, drop, repeat or move some bytes."""
    edited = bytearray(data)
    for _ in range(choose.randint(1, MAX_EDITS)):
        at, size = choose.randrange(len(edited)), choose.randint(1, 40)
        part = edited[at : at + size]
        edit = choose.randrange(4)
        if edit == 0:
            edited[at] ^= 1 << choose.randrange(8)
        elif edit == 1:
            del edited[at : at + size]
        elif edit == 2:
            edited[at:at] = part
        else:
            place = choose.randrange(len(edited))
            edited[place : place + size] = part
    return bytes(edited)


WORDS: tuple[object, ...] = (
    *(None, True, 0, 1, -1, 2**31, 2**63 - 1, -(2**63), 1e308, float("nan"), float("inf")),
    *("", "r1", "\x1b[31m", "a" * 1000, b"", b"\0" * 64, [], ["list"], ["dict"], ["again", 1]),
    *(["tuple", 1, 2], ["fixed", "world"], ["bytearray", b"1"], ["count", 0], ["slice", 0, 1, 1]),
)


def _edit_values(graph: list[Any], choose: random.Random) -> list[Any]:
    """Replace some values anywhere by others, or by parts of the same graph."""
    edited = copy.deepcopy(graph)
    for _ in range(choose.randint(1, MAX_EDITS)):
        lists = [edited]
        for one in lists:
            lists += [item for item in one if isinstance(item, list)]
        owner = choose.choice([one for one in lists if one])
        place = choose.randrange(len(owner))
        # A copy: the graph stays a tree.
        owner[place] = copy.deepcopy(choose.choice([*WORDS, choose.choice(lists)]))
        if choose.random() < 0.1:
            del owner[place]
    return edited


def _make_mutant(snapshot: bytes, choose: random.Random) -> bytes:
    header, parts, graph = _open(snapshot)
    kind = choose.randrange(3)
    if kind == 0:
        return _seal(header, _edit_bytes(snapshot.split(b"\n", 2)[2], choose))
    if kind == 1:
        digest = choose.choice(sorted(parts))
        body = _edit_bytes(parts[digest], choose)
        changed = blake2b(body, digest_size=DIGEST_BYTES).digest()
        text = msgspec.msgpack.encode(graph).replace(digest, changed)
        return _seal(header, msgspec.msgpack.encode([{**parts, changed: body}, text]))
    return _close(header, parts, _edit_values(graph, choose))


def _restore(world: World, snapshot: bytes) -> World:
    """Restore a state after that of a mutant, in another world if this one was made unfit."""
    try:
        world.restore(snapshot)
    except Invalid:
        world = World("walls", seed=3)
        world.restore(snapshot)
    return world


def _check_mutants(world: World, seeds: range) -> None:
    gc.collect()  # what other tests left removes its folders when it is collected
    snapshot = world.snapshot()
    expected = world.state_hash()
    outcomes = {"restored": 0, "refused": 0}
    for seed in seeds:
        mutant = _make_mutant(snapshot, random.Random(seed))
        with EVENTS.watched() as seen:
            try:
                world.restore(mutant)
                outcomes["restored"] += 1
            except (Invalid, Unsupported):
                outcomes["refused"] += 1
                assert world.state_hash() == expected, seed
        assert seen == [], seed
        world = _restore(world, snapshot)
        assert world.state_hash() == expected, seed
    assert min(outcomes.values()) > 0


@pytest.mark.parametrize(
    "seeds",
    [
        range(SHORT_MUTANTS),
        pytest.param(range(SHORT_MUTANTS, MUTANTS), marks=[pytest.mark.long_form, LONG]),
    ],
    ids=["some", "all"],
)
def test_mutants_are_refused_or_restored_and_run_nothing(world: World, seeds: range) -> None:
    _check_mutants(world, seeds)
