"""Built-in robots and worlds can be read, and no other files."""

from collections.abc import Callable

import pytest

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.description.builtin_models import (
    list_builtin_models,
    list_builtin_worlds,
    read_builtin_model,
    read_builtin_world,
)
from zensim.sim_server.description.sdf.sdf_world import read_world
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.errors import ModelError


def test_built_in_names_include_the_tutorials_robot_and_world() -> None:
    assert "box_bot" in list_builtin_models()
    assert "empty" in list_builtin_worlds()


@pytest.mark.parametrize("name", sorted({*list_builtin_models()} - {"box_bot_legacy"}))
def test_built_in_robot_has_only_applied_entries(name: str) -> None:
    report = read_urdf(read_builtin_model(name)).report

    assert [entry for entry in report if entry.status != "applied"] == []


@pytest.mark.parametrize("name", list_builtin_worlds())
def test_built_in_world_has_only_applied_entries(name: str) -> None:
    report = read_world(read_builtin_world(name)).report

    assert [entry for entry in report if entry.status != "applied"] == []


@pytest.mark.parametrize("name", ["", "nobody", "../models/box_bot", "box_bot.urdf", "/etc/passwd"])
@pytest.mark.parametrize(
    ("read", "shipped"), [(read_builtin_model, "box_bot"), (read_builtin_world, "empty")]
)
def test_error_lists_the_built_in_names(
    read: Callable[[str], str], shipped: str, name: str
) -> None:
    with pytest.raises(ModelError, match=shipped) as caught:
        read(name)

    assert caught.value.code == ResultCode.NOT_FOUND
