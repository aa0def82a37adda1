"""Descriptions as the operator's side reads them: what Gazebo takes is taken, the rest refused."""

import pytest

from zensim.spawner.markup import DescriptionError, Written, counted, parsed, without_comments


@pytest.mark.parametrize(
    "text",
    [
        "<robot><link/></robot>",
        "\ufeff\n<!-- -- a -- --><robot><link/></robot>",
        "<robot><link/><!-- b -- --></robot>",
        "<robot><link/><a:b c:d='1'/></robot>",
    ],
)
def test_description_is_read_as_gazebo_reads_it(text: str) -> None:
    assert parsed(text)[0].tag == "link"


@pytest.mark.parametrize(
    "text",
    [
        "",
        "<robot>",
        "<robot><!-- -- --></robt>",
        "<robot><!-- --",
        "<robot>&lol;</robot>",
        "<world/>",
        "<!DOCTYPE robot><robot/>",
        '<!-- -- --><!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>',
        "<robot>" * 70 + "</robot>" * 70,
        "<robot>\ud800</robot>",
    ],
)
def test_text_that_is_no_description_is_refused(text: str) -> None:
    with pytest.raises(DescriptionError):
        parsed(text)


def test_lines_keep_their_numbers_when_comments_are_blanked() -> None:
    assert without_comments("a<!-- b\n -- \n-->c\n<!---->") == "a\n\nc\n"


@pytest.mark.parametrize(
    ("text", "written"),
    [
        ("<robot><link/><gazebo><link/></gazebo><link/><joint/></robot>", Written(2, 1)),
        (
            "<sdf><model><link><sensor/></link><model><link/><joint/></model></model></sdf>",
            Written(2, 1),
        ),
    ],
)
def test_links_and_joints_are_counted_as_written(text: str, written: Written) -> None:
    assert counted(parsed(text)) == written
