"""Fuzzer of all parsers of untrusted bytes: `make fuzz`."""

import argparse
import random
import re
import struct
import time
from collections import Counter
from collections.abc import Callable, Iterator
from hashlib import sha256

import trimesh

from tests.hostile.corpus import corpus
from tests.hostile.sdf import sdf_cases
from tests.hostile.test_fuzz import damaged
from tests.sim_server.description.sdf_robots import PIONEER
from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    encode,
    supports_format,
)
from zensim.proto.messages import asset_messages
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_top_level_types
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.pipeline import read_robot
from zensim.sim_server.errors import ModelError, SimError
from zensim.sim_server.parser_process.asset_store import AssetStore

RUNS = 100_000
SHARES = {"urdf": 0.3, "sdf": 0.3, "bundle": 0.2, "requests": 0.2}
LONGEST_SEED = 3_000
PLAIN = 0.5
"""Share of runs with damage at any place."""
VALUE = re.compile(r"""(?:=["']|>)([^"'<>]*)(?=["'<])""")
VALUES = (
    *("nan", "inf", "-1", "0", "1e308", "1e-320", "", " ", "0 0 0", "1 1 1 1", "0x10", "1_0", "٣"),
    *("a", "b", "j", "world", "base", "__model__", "revolute", "ball", "fixed", "screw", "${x}"),
    *("../../x.stl", "model://m", "a::b", "\u202e", "n" * 300, "true", "maybe", "1 0 0", "-0 1 0"),
)
MESHES = ("stl", "obj", "dae", "glb")
Read = Callable[[random.Random], str]
"""Parses damaged input; returns the slug of its refusal, or `read`."""


def fuzz(reader: str, *, runs: int, seed: int) -> Counter[str]:
    """Run one parser; other exceptions than refusals are raised with the seed of the run.

    Returns:
        Number of runs by outcome: `read` or the slug of a refusal.
    """
    found: Counter[str] = Counter()
    with_reader = READERS[reader]()
    for run in range(runs):
        chance = random.Random(f"{reader} {seed} {run}")
        try:
            found[with_reader(chance)] += 1
        except Exception as error:
            raise AssertionError(f"{reader} fails on seed {seed}, run {run}") from error
    return found


def _urdf() -> Read:
    seeds = [read_builtin_model("box_bot"), *_texts(case.text for case in corpus())]
    return lambda chance: _description(_bent(chance.choice(seeds), chance))


def _sdf() -> Read:
    seeds = [PIONEER, *_texts(case.text for case in sdf_cases())]
    return lambda chance: _description(_bent(chance.choice(seeds), chance))


def _bent(text: str, chance: random.Random) -> str:
    """Damage a text anywhere, or only its values, so that it remains well-formed."""
    if chance.random() < PLAIN:
        return damaged(text, chance)
    for _ in range(chance.randint(1, 4)):
        spans = [match.span(1) for match in VALUE.finditer(text)]
        if spans:
            start, end = chance.choice(spans)
            text = text[:start] + chance.choice(VALUES) + text[end:]
    return text


def _texts(texts: Iterator[str]) -> list[str]:
    return [text for text in texts if len(text) < LONGEST_SEED and text.isprintable()]


def _description(text: str) -> str:
    try:
        read_robot(text, allow_missing=True)
    except ModelError as refusal:
        return refusal.slug if refusal.message.startswith(f"{refusal.slug}: ") else _nameless()
    return "read"


def _nameless() -> str:
    raise AssertionError("a refusal does not begin with its slug")


def _bundle() -> Read:
    store = AssetStore()
    seeds = {ending: make_mesh(ending) for ending in MESHES}

    def read(chance: random.Random) -> str:
        ending = chance.choice(MESHES)
        data = damage_bytes(seeds[ending], chance)
        try:
            if chance.random() < PLAIN:
                _put(store, data, chance)
            else:
                read_mesh(f"a.{ending}", data)
        except SimError as refusal:
            return refusal.slug
        except MalformedPayload:
            return "malformed"
        return "read"

    return read


def _put(store: AssetStore, data: bytes, chance: random.Random) -> None:
    name = chance.choice((sha256(data).hexdigest(), "0" * 64, "../x"))
    offset, total = (chance.choice((0, 1, 40, len(data))) for _ in range(2))
    request = asset_messages.PutAssetRequest(sha256=name, offset=offset, total=total, data=data)
    payload = encode(request, Format.MSGPACK)
    if chance.random() < PLAIN:
        payload = damage_bytes(payload, chance)
    taken = decode(asset_messages.PutAssetRequest, payload, Format.MSGPACK.value)
    store.put(taken.sha256, offset=taken.offset, total=taken.total, data=taken.data)
    store.read(taken.sha256, taken.offset, len(data))


def _requests() -> Read:
    samples = [
        (kind, encode(make_sample_message(kind), format_))
        for kind in list_top_level_types()
        for format_ in Format
        if supports_format(kind, format_)
    ]

    def read(chance: random.Random) -> str:
        kind, payload = chance.choice(samples)
        encoding = chance.choice(("", *(format_.value for format_ in Format)))
        try:
            decode(kind, damage_bytes(payload, chance), encoding)
        except MalformedPayload:
            return "malformed"
        return "read"

    return read


def damage_bytes(data: bytes, chance: random.Random) -> bytes:
    """Cut, repeat, insert or replace bytes at up to four places."""
    for _ in range(chance.randint(0, 4)):
        start = chance.randint(0, len(data))
        end = min(len(data), start + chance.choice((0, 1, 4, 50)))
        piece = chance.choice(
            (b"", chance.randbytes(end - start), data[start:end] * 2, b"\xff" * 4, b"\0" * 4)
        )
        data = data[:start] + piece + data[end:]
    return data


def make_mesh(ending: str) -> bytes:
    """Make a tetrahedron in the format of a file ending."""
    corners = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
    sides = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
    if ending == "stl":
        rows = [
            struct.pack("<12fH", 0, 0, 1, *(n for i in s for n in corners[i]), 0) for s in sides
        ]
        return bytes(80) + struct.pack("<I", len(rows)) + b"".join(rows)
    if ending == "obj":
        lines = [f"v {x} {y} {z}" for x, y, z in corners]
        return "\n".join([*lines, *(f"f {a + 1} {b + 1} {c + 1}" for a, b, c in sides)]).encode()
    exported = trimesh.Trimesh(corners, sides).export(file_type=ending)
    assert isinstance(exported, bytes)
    return exported


READERS: dict[str, Callable[[], Read]] = {
    "urdf": _urdf,
    "sdf": _sdf,
    "bundle": _bundle,
    "requests": _requests,
}


def main() -> None:
    """Run every parser for its share of the runs; print rates and outcomes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=RUNS)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    for reader, share in SHARES.items():
        began = time.perf_counter()
        found = fuzz(reader, runs=int(given.runs * share), seed=given.seed)
        took_s = time.perf_counter() - began
        first = ", ".join(f"{slug} {count}" for slug, count in found.most_common(4))
        print(f"{reader}: {found.total()} runs in {took_s:.0f} s; {len(found)} ends: {first}")  # noqa: T201


if __name__ == "__main__":
    main()
