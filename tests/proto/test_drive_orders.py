"""Drives as words."""

import pytest

from zensim.proto.drive_orders import format_drive_order, parse_drive_order
from zensim.proto.messages.drive_messages import DriveOrder


@pytest.mark.parametrize(
    ("text", "order"),
    [
        ("", DriveOrder()),
        ("none", DriveOrder("none")),
        ("planar", DriveOrder("planar")),
        ("diff:l,r", DriveOrder("diff", ("l", "r"))),
        ("diff:a+b,c+d", DriveOrder("diff", ("a", "c", "b", "d"))),
        ("diff:l,r,0.4,0.1", DriveOrder("diff", ("l", "r"), 0.4, 0.1)),
        ("mecanum:a,b,c,d", DriveOrder("mecanum", ("a", "b", "c", "d"))),
        ("bicycle:w,s,0,0.2,1.5", DriveOrder("bicycle", ("w", "s"), 0.0, 0.2, 1.5)),
    ],
)
def test_order_is_parsed_and_written_the_same(text: str, order: DriveOrder) -> None:
    assert parse_drive_order(text) == order
    assert parse_drive_order(format_drive_order(order)) == order


@pytest.mark.parametrize(
    "text", ["tank:l,r", "diff:l", "diff:a+b,c", "diff:1,l,r", "diff:l,r,1,2,3,4", ":l,r"]
)
def test_other_words_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match="`drive`"):
        parse_drive_order(text)
