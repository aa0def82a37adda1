"""`zensim`: help, version, completion and imports; `zensim up` with invalid arguments."""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Annotated

import pytest
import typer
from hypothesis import given
from hypothesis import strategies as st
from rich.text import Text
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command
from typer.testing import CliRunner

from tests.integration.processes import free_endpoint, run_in_process, zensim
from zensim.deploy.cli import VERBS, build, main
from zensim.deploy.cli.model_commands import ModelOptions
from zensim.deploy.cli.record_commands import RecordOptions
from zensim.proto.exit_codes import ExitCode
from zensim.proto.options.option_groups import expand_options, make_app
from zensim.proto.options.plain_options import parse_plain_options
from zensim.proto.verbosity import CURRENT

RUNNER = CliRunner()
SOON_S = 60.0
"""Below the wait for a server that starts later, on a machine with other work."""
NOWHERE = "tcp/127.0.0.1:1"
"""Nothing listens there; on the default endpoint another server may."""
HEAVY = ("pybullet", "viser", "scipy", "trimesh", "lxml", "zenoh", "numpy", "msgspec")
SLOW = (*HEAVY, "typer", "rich", "pydantic")


def find_heavy_imports(code: str, heavy: tuple[str, ...] = SLOW) -> set[str]:
    """Find the heavy modules that a program imports."""
    program = (
        f"import sys\ntry:\n    {code}\n"
        f"finally: print('\\n', *[name for name in {heavy} if sys.modules.get(name)])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=120, check=False
    )
    assert "Error" not in done.stderr
    return set(done.stdout.splitlines()[-1].split())


def run_main(*arguments: str) -> str:
    """Get the code that runs the command line with these arguments."""
    return f"sys.argv = {['zensim', *arguments]}; from zensim.deploy.cli import main; main()"


def test_help_lists_every_verb_with_its_summary() -> None:
    done = RUNNER.invoke(build(""), ["--help"], env={"COLUMNS": "200"})

    assert done.exit_code == ExitCode.OK
    for name, verb in VERBS.items():
        assert re.search(rf"\b{name}\b +{re.escape(verb.summary)}", done.stdout)


def test_help_is_printed_without_arguments() -> None:
    done = RUNNER.invoke(build(""), [])

    assert "Usage:" in done.output


def test_help_imports_nothing_heavy() -> None:
    assert find_heavy_imports("from zensim.deploy.cli import build; build('')") <= {
        *("typer", "rich", "pydantic")
    }


def test_up_imports_only_what_starting_programs_needs() -> None:
    unused = ("numpy", "ssl", "yaml", "sqlite3", "asyncio", "rich.progress")
    modules = ("zensim.recording", "zensim.scenario.scenario_reader", *unused)

    assert not find_heavy_imports("import zensim.deploy.cli.up_commands", modules)


@pytest.mark.parametrize("arguments", [(), ("--help",), ("--version",)])
def test_root_options_import_nothing_slow(arguments: tuple[str, ...]) -> None:
    assert find_heavy_imports(run_main(*arguments)) == set()


@pytest.mark.parametrize("text", ["", '<robot name="r"><link name="a"/></robot>'])
def test_model_of_a_robot_without_meshes_imports_nothing_slow(tmp_path: Path, text: str) -> None:
    robot = tmp_path / "r.urdf"
    robot.write_text(text)

    heavy = find_heavy_imports(run_main("model", str(robot) if text else "box_bot"))

    # The prediction of how box_bot drives needs numpy.
    assert heavy <= {"lxml", "msgspec", "typer", *(() if text else ("numpy",))}


PLAIN_WORDS = (
    "box_bot", "--json", "--strict", "--allow-missing", "--drive", "none", "--compat", "gazebo11",
    "--xacro-arg", "a:=1", "--package-path", ".", "--help", "-", "--json=1", "--nothing",
)  # fmt: skip


@given(st.lists(st.sampled_from(PLAIN_WORDS), max_size=6))
def test_options_are_parsed_alike_with_and_without_typer(words: list[str]) -> None:
    parsed: list[ModelOptions] = []
    app = make_app()
    app.command()(expand_options(make_recorder(parsed)))

    plain = parse_plain_options(ModelOptions, words, {})
    done = RUNNER.invoke(app, words)

    assert plain is None or (done.exit_code, parsed) == (ExitCode.OK, [plain])


RECORD_WORDS = (
    "r1/odom", "*/tf", "--all", "-a", "-o", "run", "--rate", "10", "1e2", "nan", "--duration", "-1",
    "1e300",
    "--exclude-topics", "--quiet", "--json", "--max-bag-size", "5MB", "--snapshot-duration", "--",
)  # fmt: skip


@given(st.lists(st.sampled_from(RECORD_WORDS), max_size=6))
def test_lists_and_numbers_are_parsed_alike_with_and_without_typer(words: list[str]) -> None:
    parsed: list[RecordOptions] = []
    app = make_app()

    def record(given: RecordOptions) -> None:
        parsed.append(given)

    app.command()(expand_options(record))

    plain = parse_plain_options(RecordOptions, words, {})
    done = RUNNER.invoke(app, words)

    assert plain is None or (done.exit_code, parsed) == (ExitCode.OK, [plain])


def test_recorder_needs_no_library_of_typer_for_values() -> None:
    assert "pydantic" not in find_heavy_imports(
        run_main("record", "--all", "--rate", "5", "--connect", NOWHERE)
    )


def test_plain_options_need_no_typer() -> None:
    words = ["--xacro-arg", "a:=1", "r.urdf", "--json", "--xacro-arg", "b:=2", "--drive", "none"]

    assert parse_plain_options(ModelOptions, words, {}) == ModelOptions(
        file="r.urdf", as_json=True, xacro_arg=["a:=1", "b:=2"], drive="none"
    )


def make_recorder(parsed: list[ModelOptions]) -> Callable[[ModelOptions], None]:
    def record(given: ModelOptions) -> None:
        parsed.append(given)

    return record


def test_model_is_parsed_by_typer_where_a_variable_may_stand_for_an_option() -> None:
    @dataclass(frozen=True)
    class Given:
        engine: Annotated[str, typer.Option("--engine", envvar="ZENSIM_ENGINE")] = ""

    words = ["--engine", "mujoco"]

    assert parse_plain_options(Given, words, {}) == Given("mujoco")
    assert parse_plain_options(Given, words, {"ZENSIM_ENGINE": "pybullet"}) is None


@pytest.mark.parametrize("arguments", [(), ("--help",), ("--version",)])
def test_root_options_print_the_same_with_and_without_typer(arguments: tuple[str, ...]) -> None:
    by_typer = RUNNER.invoke(build(""), arguments)
    done = subprocess.run(
        [sys.executable, "-m", "zensim", *arguments], capture_output=True, text=True, check=False
    )

    assert (done.returncode, done.stdout.strip()) == (by_typer.exit_code, by_typer.stdout.strip())


@pytest.mark.parametrize("words", ["scenario list", "config show up", "model box_bot"])
def test_reader_that_has_read_enough_is_no_failure(words: str) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    with os.fdopen(writer, "w") as closed:
        done = subprocess.run(
            [sys.executable, "-m", "zensim", *words.split()],
            stdout=closed,
            stderr=subprocess.PIPE,
            check=False,
        )

    assert (done.returncode, done.stderr) == (ExitCode.OK, b"")


@pytest.mark.parametrize("verb", VERBS)
def test_verb_prints_its_help(verb: str) -> None:
    done = RUNNER.invoke(build(verb), [verb, "--help"], env={"COLUMNS": "200"})

    assert done.exit_code == ExitCode.OK
    assert "--" in done.stdout


def list_commands(verb: str) -> list[TyperCommand | TyperGroup]:
    """List the command of a verb, or those of its group and the group itself if it runs alone."""
    root = get_command(build(verb))
    assert isinstance(root, TyperGroup)
    command = root.commands[verb]
    if isinstance(command, TyperGroup):
        inner = [one for one in command.commands.values() if isinstance(one, TyperCommand)]
        assert len(inner) == len(command.commands)
        return [*inner, *([command] if command.invoke_without_command else [])]
    assert isinstance(command, TyperCommand)
    return [command]


def list_spellings(command: TyperCommand | TyperGroup) -> set[str]:
    return {word for one in command.params for word in (*one.opts, *one.secondary_opts)}


@pytest.mark.parametrize("verb", VERBS)
def test_verb_prints_json_and_less_and_more(verb: str) -> None:
    for command in list_commands(verb):
        assert list_spellings(command) >= {"--json", "-q", "--quiet", "-v", "--verbose"}


def test_up_has_every_option_of_serve() -> None:
    (serve,), (up,) = list_commands("serve"), list_commands("up")

    assert "--lockstep-timeout" in list_spellings(serve)
    assert list_spellings(serve) - list_spellings(up) == set()


def test_printed_help_keeps_units() -> None:
    done = RUNNER.invoke(build("drive"), ["drive", "--help"], env={"COLUMNS": "200"})

    assert "Forward velocity [m/s]" in done.stdout
    assert "[rad/s]" in done.stdout


def test_usage_of_up_writes_its_optional_file_once_in_brackets() -> None:
    done = RUNNER.invoke(build("up"), ["up", "--help"], env={"COLUMNS": "200"})

    assert "zensim up [OPTIONS] [FILE]" in done.stdout.replace("root up", "zensim up")


@pytest.mark.parametrize("verb", VERBS)
def test_help_texts_keep_their_brackets(verb: str) -> None:
    """Rich drops [m] as unknown markup unless the bracket is escaped."""
    commands = list_commands(verb)
    texts = [
        text
        for one in commands
        for text in (one.help, one.epilog, *(getattr(p, "help", "") for p in one.params))
        if text
    ]

    assert [Text.from_markup(text).plain for text in texts] == [
        text.replace("\\[", "[") for text in texts
    ]


def test_verbs_import_no_engine_and_no_viewer() -> None:
    code = "from zensim.deploy.cli import VERBS, build; [build(verb) for verb in VERBS]"

    assert not find_heavy_imports(code) & {"pybullet", "viser", "scipy", "trimesh", "lxml"}


def test_version_is_that_of_the_package() -> None:
    done = RUNNER.invoke(build(""), ["--version"])

    assert (done.exit_code, done.stdout) == (ExitCode.OK, f"zensim {version('zensim')}\n")


@pytest.mark.parametrize("verb", ["topic", "world"])
def test_group_prints_help_without_a_command(verb: str) -> None:
    done = zensim(verb)

    assert f"Usage: zensim {verb} [OPTIONS] COMMAND" in done.stdout + done.stderr
    assert done.returncode == ExitCode.USAGE


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ("model nofile.urdf --json", ExitCode.NOT_FOUND),
        ("model box_bot --json --drive foo", ExitCode.USAGE),
        ("serve --json --rtf abc", ExitCode.USAGE),
        ("list --json --foo", ExitCode.USAGE),
    ],
)
def test_failure_is_an_object_with_json(
    words: str,
    status: ExitCode,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(sys, "argv", ["zensim", *words.split()])
    monkeypatch.setattr(CURRENT, "is_json", False)

    with pytest.raises(SystemExit) as ended:
        main()

    failure = json.loads(capsys.readouterr().err)["error"]
    assert (ended.value.code, failure["number"]) == (status, status)
    assert words.startswith(failure["command"])


def test_export_without_a_server_is_unreachable(tmp_path: Path) -> None:
    file = tmp_path / "x.scenario.yaml"

    done = run_in_process("export", str(file), "--connect", "tcp/127.0.0.1:1")

    assert done.returncode == ExitCode.UNREACHABLE
    assert "zensim.launch" not in done.stderr


def test_wrong_value_of_a_file_names_the_file(tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text("serve: {rtf: abc}")

    done = run_in_process("serve", "--config", str(file))

    assert done.returncode == ExitCode.USAGE
    assert "wrong.yaml" in re.sub(r"[\s│]", "", done.stderr)


def test_unknown_verb_is_refused() -> None:
    done = zensim("levitate")

    assert done.returncode == ExitCode.USAGE
    assert "levitate" in done.stderr


@pytest.mark.parametrize(
    ("arguments", "value"),
    [
        (("--layout", "spiral"), "--layout"),
        (("--spacing", "0"), "spacing"),
        (("--world-name", "my world"), "'my world'"),
        (("--listen", "here"), "'here'"),
        (("--model", "my robot.urdf"), "'my robot'"),
    ],
)
def test_up_refuses_invalid_arguments_in_one_line(arguments: tuple[str, ...], value: str) -> None:
    done = zensim("up", *arguments)

    assert done.returncode == ExitCode.USAGE
    assert done.stderr.startswith("zensim up: ")
    assert value in done.stderr
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


@pytest.mark.parametrize("words", [("nowhere",), ("empty", "./nowhere.sdf")])
def test_world_that_is_not_there_is_not_found_before_any_is_read(words: tuple[str, ...]) -> None:
    done = run_in_process("world", "inspect", *words)

    assert done.returncode == ExitCode.NOT_FOUND
    assert done.stderr.startswith(f"zensim world inspect: {words[-1]}: ")
    assert done.stderr.count("\n") == 1
    assert done.stdout == ""


def test_sensor_process_without_a_server_ends_as_soon_as_other_verbs() -> None:
    began_s = time.monotonic()
    endpoint = free_endpoint()

    done = zensim("sensors", "run", "--connect", endpoint)

    assert done.returncode == ExitCode.UNREACHABLE
    assert done.stderr.startswith("zensim sensors run: ")
    assert done.stderr.count("\n") == 1
    assert time.monotonic() - began_s < SOON_S


def test_up_prints_the_error_of_its_server() -> None:
    done = zensim("up", "--world", "nowhere.sdf", "--listen", "tcp/127.0.0.1:0", "--no-viewer")

    assert done.returncode == ExitCode.FAILED
    assert "zensim serve: " in done.stderr
    assert "nowhere.sdf" in done.stderr
    assert "zensim up: " in done.stderr


@pytest.mark.parametrize(
    ("line", "word", "completions"),
    [
        ("zensim p", 1, "pause\nplay\n"),
        ("zensim spawn --str", 2, "--strict\n"),
        ("zensim world load --al", 3, "--allow-missing\n"),
    ],
)
def test_shell_completes_verbs_and_their_options(line: str, word: int, completions: str) -> None:
    variables = {"_ZENSIM_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(word)}
    done = subprocess.run(
        [sys.executable, "-c", "from zensim.deploy.cli import main; main()"],
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
        env={**os.environ, **variables},
    )

    assert done.stdout == completions
