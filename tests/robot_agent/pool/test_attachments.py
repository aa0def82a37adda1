"""Attachments of many publishers are those of each."""

from zensim.proto.ros2.rmw_attachment import Attachment, write_attachment
from zensim.robot_agent.pool.attachments import Attachments

GID = bytes(range(16))


def test_attachments_of_many_are_those_of_each() -> None:
    gids = [bytes([number]) * 16 for number in range(5)]
    many = Attachments()
    rows = [many.add(gid) for gid in gids]

    written = [many.following(rows, 7), many.following(rows[3:1:-1], 8), many.following(rows, 9)]

    assert written == [
        [write_attachment(Attachment(1, 7, gid)) for gid in gids],
        [write_attachment(Attachment(2, 8, gid)) for gid in gids[3:1:-1]],
        [
            write_attachment(Attachment(number, 9, gid))
            for number, gid in zip((2, 2, 3, 3, 2), gids, strict=True)
        ],
    ]


def test_attachments_of_who_came_for_another_begin_anew() -> None:
    many = Attachments()
    row = many.add(GID)
    many.following([row], 1)

    many.remove(row)
    others = [many.add(bytes(16)), many.add(GID)]

    assert many.following(others, 2) == [
        write_attachment(Attachment(1, 2, gid)) for gid in (bytes(16), GID)
    ]
