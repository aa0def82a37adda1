"""Definitions in recordings have the type hashes that zensim announces."""

import msgspec
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from zensim.proto.codec.message_codec import Format, supports_format
from zensim.proto.messages.standard_messages import Empty
from zensim.proto.ros2.message_definitions import SEPARATOR, write_definition
from zensim.proto.ros2.type_hash import hash_type
from zensim.proto.schema import list_messages


def list_recordable_types() -> list[type[msgspec.Struct]]:
    return [
        kind
        for kind in list_messages().values()
        if "/msg/" in getattr(kind, "ros_type", "") and supports_format(kind, Format.CDR)
    ]


@pytest.mark.parametrize("kind", list_recordable_types(), ids=lambda kind: kind.__name__)
def test_definition_has_the_type_hash_of_its_struct(kind: type[msgspec.Struct]) -> None:
    store = get_typestore(Stores.EMPTY)
    name = str(vars(kind).get("ros_type") or kind.ros_type)  # type: ignore[attr-defined]

    store.register(get_types_from_msg(write_definition(kind), name))

    assert store.hash_rihs01(name) == hash_type(kind)


def test_definition_of_an_empty_message_is_empty() -> None:
    text = write_definition(Empty)

    assert SEPARATOR not in text
    assert not text.strip()
