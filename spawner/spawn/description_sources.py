"""Read a description from a file, built-in model, model folder, stream or topic; expand xacro."""

import os
import re
import time
from collections.abc import Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import msgspec

from zensim.proto.bounded_files import FileTooLarge, read_file
from zensim.proto.child_process import make_module_command, run_process
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.proto.names import NAME_PATTERN
from zensim.spawner.spawn.description_xml import (
    MAX_TEXT_BYTES,
    DescriptionError,
    blank_comments,
    make_refusal,
)
from zensim.spawner.spawn.search_paths import SearchPaths, find_model_file, to_package_uris
from zensim.spawner.spawn.xacro_process import (
    CPU_LIMIT_S,
    XacroRequest,
    XacroResult,
    encode_request,
)

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus
    from zensim.proto.network_protocols import Sample

XACRO_SUFFIX = ".xacro"
XACRO_TAG = "<xacro:"
XACRO_COMMAND = make_module_command("zensim.spawner.spawn.xacro_process")
XACRO_TIMEOUT_S = 60.0
"""Wall time; the limit of CPU time is lower, so only a process that sleeps takes this long."""
XACRO_TOO_LONG = f"it takes more than {CPU_LIMIT_S} s of CPU time"


def is_xacro(text: str, path: Path) -> bool:
    """Whether a file is xacro: by its suffix, or by a tag outside of comments."""
    return path.suffix == XACRO_SUFFIX or XACRO_TAG in blank_comments(text)


def parse_xacro_arguments(words: Sequence[str]) -> dict[str, str]:
    """Parse `key:=value` arguments.

    Raises:
        ValueError: A word has no key or no separator.
    """
    pairs = [word.partition(":=") for word in words]
    for word, (key, separator, _) in zip(words, pairs, strict=True):
        if not key or not separator:
            raise ValueError(f"`xacro_arg` must be key:=value, got {word[:80]!r}")
    return {key: value for key, _, value in pairs}


def expand_xacro(text: str, path: Path, arguments: Mapping[str, str], paths: SearchPaths) -> str:
    """Expand xacro in a process with limited CPU time and memory.

    Args:
        text: Content of the file.
        path: Path of the file; includes are relative to its folder.
        arguments: Values of `<xacro:arg>`.
        paths: Search paths of `$(find PACKAGE)`, besides those of ROS.

    Raises:
        DescriptionError: The text cannot be expanded, or xacrodoc is not installed.
    """
    result = _run_xacro_process(XacroRequest(text, path, dict(arguments), paths))
    if result.missing:
        raise DescriptionError(result.missing)
    if result.reason:
        raise DescriptionError(f"{path} cannot be expanded: {result.reason}")
    return result.text


SUBSTITUTION_ARG = re.compile(r"(?<!\$)\$\(\s*(arg|env|optenv)\s+([^()\s]+)\s*([^()]*?)\s*\)")


def expand_substitution_args(
    text: str, arguments: Mapping[str, str], environment: Mapping[str, str]
) -> str:
    """Expand the substitution arguments of roslaunch and xacro in a text that is no xacro.

    `$(find PACKAGE)` becomes a package URI, so that no path of this host is sent. An argument or
    variable that is not given stays as it is, for the server to name it.

    Args:
        text: URDF or SDF.
        arguments: Values of `$(arg NAME)`.
        environment: Values of `$(env NAME)` and `$(optenv NAME DEFAULT)`.
    """

    def expand(found: re.Match[str]) -> str:
        kind, name, default = found.groups()
        given = arguments if kind == "arg" else environment
        if name in given:
            return escape(given[name])
        return default if kind == "optenv" else found[0]

    return to_package_uris(SUBSTITUTION_ARG.sub(expand, text))


def _run_xacro_process(request: XacroRequest) -> XacroResult:
    outcome = run_process(XACRO_COMMAND, encode_request(request), timeout_s=XACRO_TIMEOUT_S)
    if outcome.is_out_of_time:
        return XacroResult(reason=XACRO_TOO_LONG)
    if outcome.status:
        return XacroResult(reason=f"xacro exited with status {outcome.status}")
    return msgspec.msgpack.decode(outcome.output, type=XacroResult)


TOPIC_KEY = re.compile(r"[^/?#*$\s]+(?:/[^/?#*$\s]+)*")
PACKAGE_URI = re.compile(r"(<mesh\b[^>]*?\bfilename\s*=\s*[\"']\s*)package://")
LATIN_DECLARATION = re.compile(
    rb"""<\?xml\b[^>]{0,200}?\bencoding\s*=\s*["'](iso-8859-15?|latin-?1|windows-1252)["']""", re.I
)
POLL_S = 0.02
GET_TIMEOUT_S = 1.0
STDIN_PATH = Path("standard input")
"""Path in error texts; includes are relative to the working directory."""


class RobotDescription(msgspec.Struct, frozen=True):
    """A description: its text, or the name of a built-in model of the server."""

    text: str = ""
    """Empty if `uri` names a model of the server."""
    uri: str = ""
    path: Path | None = None
    """The file that it was read from."""


def read_model_argument(
    model: str, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read a file by its path, or a built-in model by its name.

    Raises:
        FileNotFoundError: There is no such file, and the word is not a valid name.
        DescriptionError: The file is not text, or cannot be expanded.
    """
    if Path(model).is_file():
        return read_description_file(Path(model), arguments, paths)
    if model and Path(model).is_dir():
        raise IsADirectoryError(21, "is a folder; give a file of it", model)
    if not NAME_PATTERN.fullmatch(model):
        raise FileNotFoundError(2, "no such file or built-in model", model)
    return _read_builtin_model(model) or RobotDescription(uri=model)


def read_description_file(
    file: Path, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read a URDF, SDF or xacro file.

    Raises:
        OSError: The file cannot be read.
        DescriptionError: The file is not text, or cannot be expanded.
        ServiceError: The file is too large.
    """
    try:
        data = read_file(file, MAX_TEXT_BYTES)
    except FileTooLarge as error:
        raise _too_large_error(f"{file} has more than {MAX_TEXT_BYTES} bytes") from error
    if not data:
        raise make_refusal(SpawnCode.NO_RESOURCE, "resource.empty", f"{file} is empty")
    text = decode_description(data, str(file))
    if is_xacro(text, file):
        text = expand_xacro(text, file, arguments, paths.with_folder_of(file))
    else:
        text = expand_substitution_args(text, arguments, os.environ)
    return RobotDescription(text, path=file)


def read_description_stream(
    stream: BinaryIO, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read a URDF, SDF or xacro from standard input.

    Raises:
        DescriptionError: The input is not text, or cannot be expanded.
        ServiceError: The input is too large.
    """
    data = stream.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise _too_large_error(f"{STDIN_PATH} has more than {MAX_TEXT_BYTES} bytes")
    text = decode_description(data, str(STDIN_PATH))
    if is_xacro(text, STDIN_PATH):
        text = expand_xacro(text, STDIN_PATH, arguments, paths)
    else:
        text = expand_substitution_args(text, arguments, os.environ)
    return RobotDescription(text)


def _too_large_error(fault: str) -> ServiceError:
    return make_refusal(
        SpawnCode.RESOURCE_PARSE_ERROR, "xml.size", f"{fault}; the limit is {MAX_TEXT_BYTES}"
    )


def decode_description(data: bytes, where: str) -> str:
    """Decode XML: UTF-16 with a byte order mark, a declared Latin encoding, or UTF-8.

    Invalid bytes in comments are ignored.

    Raises:
        DescriptionError: A byte is invalid.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    else:
        declared = LATIN_DECLARATION.match(data)
        encoding = declared[1].decode().lower() if declared else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        text = data.decode(encoding, "replace")
        if encoding == "utf-8-sig" and "\ufffd" not in blank_comments(text):
            return text
        raise DescriptionError(
            f"{where} cannot be decoded: byte {error.start} is not {error.encoding}; use UTF-8"
        ) from error


def find_model_by_name(
    name: str, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Find a model by name: in a folder of the search paths, or built in.

    Raises:
        FileNotFoundError: There is no such model.
    """
    for folder in paths.package_folders(name):
        if (file := find_model_file(folder)) is not None:
            return read_description_file(file, arguments, paths)
    if NAME_PATTERN.fullmatch(name) and (model := _read_builtin_model(name)):
        return model
    raise FileNotFoundError(2, "no such model in GAZEBO_MODEL_PATH or built in", name)


def _read_builtin_model(name: str) -> RobotDescription | None:
    file = resources.files("zensim.sim_server") / "models" / f"{name}.urdf"
    return RobotDescription(file.read_text(encoding="utf-8"), name) if file.is_file() else None


def receive_description(bus: "Bus", key: str, timeout_s: float) -> RobotDescription:
    """Receive a description from a topic: the latched message, or the next one.

    Raises:
        ValueError: The key is not valid.
        TimeoutError: No message arrived.
        DescriptionError: The message is not a text.
    """
    bare = key.removeprefix("/")
    if not TOPIC_KEY.fullmatch(bare):
        raise ValueError(f"-topic must be a key such as r1/robot_description, got {key[:80]!r}")
    subscription = bus.subscribe(bare)
    deadline = time.monotonic() + timeout_s
    try:
        latched = bus.get(bare, min(timeout_s, GET_TIMEOUT_S))
        sample = latched[0] if latched else subscription.newest()
        while sample is None:
            if time.monotonic() >= deadline:
                raise TimeoutError(f"no description on {bare} within {timeout_s:g} s")
            time.sleep(POLL_S)
            sample = subscription.newest()
    finally:
        subscription.close()
    return RobotDescription(_decode_message(sample))


def _decode_message(sample: "Sample") -> str:
    from zensim.proto.codec.message_codec import MalformedPayload, decode
    from zensim.proto.messages.standard_messages import String

    data = sample.payload
    if data.lstrip()[:1] == b"<" or data[:3] == b"\xef\xbb\xbf":
        return decode_description(data, sample.key)
    try:
        return decode(String, data, sample.encoding).data
    except MalformedPayload as error:
        raise DescriptionError(
            f"the message on {sample.key} is not a description: {error}"
        ) from error


def to_model_uris(description: RobotDescription) -> RobotDescription:
    """Replace `package://` by `model://` in the file names of meshes."""
    text = PACKAGE_URI.sub(r"\1model://", description.text)
    return msgspec.structs.replace(description, text=text)
