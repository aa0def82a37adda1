"""Every option has a variable and a key; a flag beats a variable, a variable the file."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from zensim.deploy.cli import GROUPS, VERBS, build
from zensim.deploy.cli.command_settings import (
    Command,
    CommandSettings,
    Option,
    add_settings,
    find_key,
    list_commands,
    list_options,
    read_settings,
)
from zensim.proto.setting_variables import has_variables, name_variable
from zensim.scenario.scenario_nodes import ScenarioInvalid

Context = Any


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in list(os.environ):
        if name.startswith("ZENSIM_"):
            monkeypatch.delenv(name)


def find_verb(verb: str) -> Command:
    command = get_command(build(verb)).commands[verb]  # type: ignore[attr-defined]
    add_settings(command, verb)
    return command


def list_all_commands() -> Iterator[tuple[str, Command]]:
    for verb in VERBS:
        yield from list_commands(find_verb(verb), verb)


def find_value(command: Command, option: Option, monkeypatch: pytest.MonkeyPatch) -> str:
    """Find a value that an option accepts as a variable, and leave the variable unset."""
    if option.is_flag:
        return "false" if option.default is True else "true"
    for text in ("2", "0.5", "2 2 2", "nav2", "here"):
        monkeypatch.setenv(option.envvar[0], text)
        with suppress(Exception):
            parse(command, [])
            monkeypatch.delenv(option.envvar[0])
            return text
    raise AssertionError(option.opts)


def to_yaml(text: str) -> str:
    return f"[{', '.join(text.split())}]" if " " in text else text


def parse(command: Command, words: list[str]) -> Context:
    command.no_args_is_help = False
    for parameter in command.params:
        parameter.required = False
    return command.make_context("x", words)


def sources_of(context: Context, options: dict[str, Option]) -> dict[str, str]:
    return {key: context.get_parameter_source(one.name).name for key, one in options.items()}


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_has_a_variable_that_is_read(
    verb: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, command in list_commands(find_verb(verb), verb):
        options = list_options(command)
        for key, option in options.items():
            assert option.envvar[0] == name_variable(name, key)
            monkeypatch.setenv(option.envvar[0], find_value(command, option, monkeypatch))
        context = parse(command, [])

        assert set(sources_of(context, options).values()) <= {"ENVIRONMENT"}


@pytest.mark.parametrize("verb", VERBS)
def test_every_option_is_a_key_of_the_file(
    verb: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name, command in list_commands(find_verb(verb), verb):
        if name == "config show":  # its --config is that of the command that it shows
            continue
        options = list_options(command)
        if not options:
            continue
        found = {key: find_value(command, one, monkeypatch) for key, one in options.items()}
        lines = [f"  {key}: {to_yaml(text)}" for key, text in found.items()]
        file = tmp_path / "zensim.yaml"
        file.write_text("\n".join([f'"{name}":', *lines]))
        context = parse(command, ["--config", str(file)])

        assert set(sources_of(context, options).values()) <= {"DEFAULT_MAP"}


def test_variables_are_unique() -> None:
    names = [
        option.envvar[0]
        for _, command in list_all_commands()
        for option in list_options(command).values()
    ]

    assert len(names) > 300
    assert len(names) == len(set(names))


def test_keys_are_the_spellings_of_options() -> None:
    for _, command in list_all_commands():
        for key, option in list_options(command).items():
            assert f"--{key}" in option.opts
            assert key == find_key(option)


@pytest.mark.parametrize(
    ("flag", "variable", "file", "expected"),
    [
        ("4", "3", "2", (4.0, "COMMANDLINE")),
        ("", "3", "2", (3.0, "ENVIRONMENT")),
        ("", "", "2", (2.0, "DEFAULT_MAP")),
        ("", "", "", (None, "DEFAULT")),
    ],
)
def test_flag_then_variable_then_file_then_default(
    flag: str,
    variable: str,
    file: str,
    expected: tuple[float | None, str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    path = tmp_path / "zensim.yaml"
    path.write_text(f"serve: {{rtf: {file}}}" if file else "agent: {pool: 1}")
    monkeypatch.setenv("ZENSIM_SERVE_RTF", variable)
    monkeypatch.setenv("ZENSIM_CONFIG", str(path))

    context = parse(find_verb("serve"), ["--rtf", flag] if flag else [])

    assert (context.params["rtf"], context.get_parameter_source("rtf").name) == expected


def test_variable_of_the_command_beats_the_shared_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ZENSIM_JOURNAL", "shared")
    monkeypatch.setenv("ZENSIM_SERVE_JOURNAL", "own")

    context = parse(find_verb("serve"), [])

    assert context.params["journal"] == Path("own")


def test_list_in_a_file_is_a_repeated_option(tmp_path: Path) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text("serve:\n  model-path: [a, b]\n  paused: true\n")

    context = parse(find_verb("serve"), ["--config", str(file)])

    assert context.params["model_paths"] == [Path("a"), Path("b")]
    assert context.params["paused"] is True


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1.10", "1.10"),
        ("007", "007"),
        ("true", "true"),
        ("0x10", "16"),
        ("&name 1.10", "1.10"),
        ("'1.10'", "1.10"),
        ("ab", "ab"),
    ],
)
def test_text_in_a_file_keeps_its_spelling(text: str, expected: str, tmp_path: Path) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text(
        f"agent: {{pool: 1}}\nserve: {{rtf: 2, world-name: {text}, seed: 0x10, paused: true}}\n"
    )

    context = parse(find_verb("serve"), ["--config", str(file)])

    assert context.params["world_name"] == expected
    assert (context.params["seed"], context.params["paused"]) == (16, True)


def test_section_of_another_command_of_a_group_is_ignored(tmp_path: Path) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text('"sensors run": {always: true}\nserve: {rtf: 2}\n')

    context = parse(find_verb("serve"), ["--config", str(file)])

    assert context.params["rtf"] == 2.0


def test_groups_without_settings_are_listed() -> None:
    found = {name for name, one in list_all_commands() if hasattr(one, "commands")}

    assert found == GROUPS | {"sweep", "sensors"}


@pytest.mark.parametrize(
    ("text", "jobs"),
    [
        ("sweep: {jobs: 3}", 3),
        ('"sweep run": {jobs: 3}', 3),
        ('"sweep run": {jobs: 3}\nsweep: {jobs: 2}', 3),
    ],
)
def test_command_that_may_be_left_out_has_the_section_of_its_group(
    text: str, jobs: int, tmp_path: Path
) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text(text)
    run = find_verb("sweep").commands["run"]

    assert parse(run, ["--config", str(file)]).params["jobs"] == jobs


def test_mistake_in_the_section_of_such_a_group_has_its_place(tmp_path: Path) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text("sweep: {jobs: 1, outptu: x}")
    run = find_verb("sweep").commands["run"]
    options = list_options(run)

    with pytest.raises(ScenarioInvalid, match="outptu"):
        read_settings(file, CommandSettings("sweep run", options, "sweep"))


def test_command_that_may_be_left_out_has_the_variables_of_its_group(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("ZENSIM_SWEEP_JOBS", "2")
    assert parse(find_verb("sweep").commands["run"], []).params["jobs"] == 2

    monkeypatch.setenv("ZENSIM_SWEEP_RUN_JOBS", "3")
    assert parse(find_verb("sweep").commands["run"], []).params["jobs"] == 3


@pytest.mark.parametrize(
    "text",
    [
        "serv: {rtf: 1}",
        "serve: {rtff: 1}",
        "serve: {rtf: {a: 1}}",
        "serve: 3",
        "- serve",
        '"serve foo": {rtf: 1}',
        "topic: {foo: 1}",
        "world: {x: 2}",
        "bag:",
        '"sensors walk": {always: true}',
        '"sensors  run": {always: true}',
        "serve: {rtf: 1, rtf: 2}",
        "serve: ]",
    ],
)
def test_mistake_in_a_file_has_its_place(text: str, tmp_path: Path) -> None:
    file = tmp_path / "zensim.yaml"
    file.write_text(text)
    settings = CommandSettings("serve", list_options(find_verb("serve")))

    with pytest.raises(ScenarioInvalid) as caught:
        read_settings(file, settings)

    assert caught.value.issues[0].place.line == 1


def test_variables_of_a_command_are_noticed() -> None:
    assert has_variables("record", {"ZENSIM_RECORD_SYNC": "1"})
    assert has_variables("record", {"ZENSIM_CONFIG": "x"})
    assert not has_variables("record", {"ZENSIM_RECORD_SYNC": "", "ZENSIM_SERVE_RTF": "1"})
