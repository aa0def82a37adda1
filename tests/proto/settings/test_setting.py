"""A setting stands once: all its forms are made from its field."""

from typing import Annotated

import msgspec
import pytest
from typer.models import OptionInfo

from benchmarks.settings_page import PAGE, replace_table
from zensim.proto.settings.engine_settings import EngineSettings
from zensim.proto.settings.server_settings import ServerSettings, WorldKeywords
from zensim.proto.settings.setting import (
    Setting,
    change_settings,
    check_settings,
    find_setting,
    list_settings,
    make_settings,
    read_settings,
    write_help,
    write_words,
)
from zensim.proto.settings.setting_options import make_option_parameters
from zensim.scenario.setting_sections import list_keys, make_section


class AddedSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings that a test adds."""

    spare_cells: Annotated[
        int,
        Setting(
            help="Number of cells in store.",
            panel="Physics",
            metavar="N",
            least=0,
            most=8,
            key="engine.spare_cells",
            variables=("ZENSIM_SPARE_CELLS",),
        ),
    ] = 2


class ExtendedSettings(ServerSettings, frozen=True, kw_only=True):
    """Settings of a server with those."""

    added: AddedSettings = AddedSettings()


def option_of(name: str) -> OptionInfo:
    parameters = {one.name: one for one in make_option_parameters(ExtendedSettings)}
    found: OptionInfo = parameters[name].annotation.__metadata__[0]
    return found


def test_added_setting_is_an_option_with_its_variables() -> None:
    option = option_of("spare_cells")

    assert option.default == "--spare-cells"
    assert option.envvar == ["ZENSIM_SPARE_CELLS"]
    assert (option.metavar, option.rich_help_panel) == ("N", "Physics")
    assert option.help == "Number of cells in store."


def test_added_setting_is_an_argument_of_programs_unless_it_has_its_default() -> None:
    changed = make_settings(ExtendedSettings, {"spare_cells": 3})

    assert write_words(changed) == ("--spare-cells", "3")
    assert write_words(ExtendedSettings()) == ()


def test_added_setting_is_a_key_of_scenario_files() -> None:
    section = make_section("Extended", "Engine.", [*list_keys(ExtendedSettings, "engine")])

    assert section().spare_cells == 2
    assert msgspec.convert({"spare_cells": 5}, section).spare_cells == 5
    with pytest.raises(msgspec.ValidationError):
        msgspec.convert({"spare_cells": 9}, section)


@pytest.mark.parametrize("wrong", [-1, 9])
def test_added_setting_is_refused_by_name_when_it_is_out_of_range(wrong: int) -> None:
    with pytest.raises(ValueError, match="`spare_cells`"):
        make_settings(ExtendedSettings, {"spare_cells": wrong})


@pytest.mark.parametrize("wrong", [1.5, True, "2", float("nan")])
def test_added_setting_is_a_whole_number(wrong: object) -> None:
    with pytest.raises(ValueError, match="whole number"):
        change_settings(AddedSettings(), {"spare_cells": wrong})


def test_value_is_passed_on_whole() -> None:
    changed = change_settings(ExtendedSettings(), {"spare_cells": 3, "step_hz": 100.0})

    assert (changed.added.spare_cells, changed.pace.step_hz) == (3, 100.0)
    assert read_settings(changed)["spare_cells"] == 3
    check_settings(changed)


def test_none_and_an_empty_word_stand_for_the_default() -> None:
    changed = make_settings(ServerSettings, {"engine": "", "control_hz": None})

    assert changed == ServerSettings()


def test_unknown_word_is_refused_with_the_words_that_work() -> None:
    with pytest.raises(ValueError, match=r"`clusters` .*auto, on, off"):
        make_settings(ServerSettings, {"clusters": "maybe"})


def test_group_that_was_changed_by_hand_is_checked() -> None:
    wrong = ServerSettings(physics=EngineSettings(engine_workers=-1))

    with pytest.raises(ValueError, match="`engine_workers`"):
        check_settings(wrong)


def test_help_has_the_unit() -> None:
    assert write_help(find_setting(ServerSettings, "step_hz")) == (
        "Physics rate [Hz, simulation time]."
    )


def test_page_of_settings_has_each() -> None:
    page = PAGE.read_text(encoding="utf-8")

    assert page == replace_table(page), "run 'python -m benchmarks.settings_page'"


def test_each_keyword_of_a_world_is_a_setting() -> None:
    names = {one.name for one in list_settings(ServerSettings)}

    assert set(WorldKeywords.__annotations__) <= names
