"""Where numbers lie in CDR, told without reading it."""

import struct
from operator import attrgetter

import msgspec
import pytest
from hypothesis import given

from tests.proto.strategies import messages_of
from tests.proto.widest import Widest
from zensim.proto import cdr
from zensim.proto.cdr_layout import Fixed, Layout, Numbers
from zensim.proto.cdr_places import places_of
from zensim.proto.geometry import TransformStamped
from zensim.proto.header import Header, Time
from zensim.proto.topics import JointState, Odometry, TFMessage


def numbers_of(message: msgspec.Struct) -> dict[str, tuple[str, object]]:
    """List a message's own numbers by path, with their codes; not those of items."""
    found: dict[str, tuple[str, object]] = {}
    for leaf in Layout(type(message)).leaves:
        if not isinstance(leaf, Fixed | Numbers) or not leaf.path:
            continue
        value = attrgetter(leaf.path)(message)
        if isinstance(leaf, Fixed) and leaf.length is None:
            found[leaf.path] = (leaf.code, value)
        else:
            found |= {f"{leaf.path}[{i}]": (leaf.code, one) for i, one in enumerate(value)}
    return found


@given(message=messages_of(Widest))
def test_numbers_are_at_their_places_whatever_the_message(message: Widest) -> None:
    payload, places = cdr.encode(message), places_of(message)

    for path, (code, value) in numbers_of(message).items():
        (found,) = struct.unpack_from(f"<{code}", payload, places[path])
        assert found == value


@pytest.mark.parametrize("kind", [Odometry, JointState])
def test_places_name_all_numbers(kind: type[msgspec.Struct]) -> None:
    assert set(places_of(kind())) == set(numbers_of(kind()))


def test_numbers_of_items_are_found_behind_texts_of_any_length() -> None:
    transforms = tuple(
        TransformStamped(Header(Time(7, 8), "f" * length), "c" * length) for length in range(5)
    )
    message = TFMessage(transforms)
    payload, places = cdr.encode(message), places_of(message)

    for number in range(5):
        stamp = struct.unpack_from("<iI", payload, places[f"transforms[{number}].header.stamp.sec"])
        turn = places[f"transforms[{number}].transform.rotation.w"]
        assert stamp == (7, 8)
        assert struct.unpack_from("<d", payload, turn) == (1.0,)
