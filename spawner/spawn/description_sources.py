"""Where a description comes from: a file, a shipped model, a model folder, a stream or a key; xacro is expanded."""

import re
import time
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import BinaryIO

import msgspec

from zensim.proto.bus import Bus
from zensim.proto.child_process import make_module_command, run_process
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.proto.messages.standard_messages import String
from zensim.proto.names import NAME_PATTERN
from zensim.proto.network_protocols import Sample
from zensim.spawner.spawn.description_xml import (
    MAX_TEXT_BYTES,
    DescriptionError,
    blank_comments,
    make_refusal,
)
from zensim.spawner.spawn.search_paths import SearchPaths, find_model_file
from zensim.spawner.spawn.xacro_process import (
    CPU_LIMIT_S,
    XacroRequest,
    XacroResult,
    encode_request,
)

XACRO_SUFFIX = ".xacro"
XACRO_TAG = "<xacro:"
XACRO_COMMAND = make_module_command("zensim.spawner.spawn.xacro_process")
XACRO_TIMEOUT_S = 60.0
"""Of wall time: only one that sleeps takes as long."""
XACRO_TOO_LONG = f"it takes more than {CPU_LIMIT_S} s"


def is_xacro(text: str, path: Path) -> bool:
    """Whether a file is xacro: by its ending, or by the tags in it, comments apart."""
    return path.suffix == XACRO_SUFFIX or XACRO_TAG in blank_comments(text)


def parse_xacro_arguments(words: Sequence[str]) -> dict[str, str]:
    """Read `key:=value` words.

    Raises:
        ValueError: One is none.
    """
    pairs = [word.partition(":=") for word in words]
    for word, (key, separator, _) in zip(words, pairs, strict=True):
        if not key or not separator:
            raise ValueError(f"--xacro-arg {word[:80]!r} is no argument; use key:=value")
    return {key: value for key, _, value in pairs}


def expand_xacro(text: str, path: Path, arguments: Mapping[str, str], paths: SearchPaths) -> str:
    """Expand xacro, in a process with little time and memory.

    Args:
        text: What is in the file.
        path: The file; includes are relative to its folder.
        arguments: Values of its `<xacro:arg>`s.
        paths: Where `$(find PACKAGE)` looks, besides ROS's own places.

    Raises:
        DescriptionError: It cannot be expanded, or xacrodoc is not installed.
    """
    found = _run_xacro_process(XacroRequest(text, path, dict(arguments), paths))
    if found.sentence:
        raise DescriptionError(found.sentence)
    if found.reason:
        raise DescriptionError(
            f"{path} cannot be expanded: {found.reason}; give arguments by --xacro-arg key:=value "
            "and packages by --package-path"
        )
    return found.text


def _run_xacro_process(wish: XacroRequest) -> XacroResult:
    outcome = run_process(XACRO_COMMAND, encode_request(wish), timeout_s=XACRO_TIMEOUT_S)
    if outcome.is_out_of_time:
        return XacroResult(reason=XACRO_TOO_LONG)
    if outcome.status:
        return XacroResult(reason=f"xacro ended over it (status {outcome.status})")
    return msgspec.msgpack.decode(outcome.output, type=XacroResult)


TOPIC_KEY = re.compile(r"[^/?#*$\s]+(?:/[^/?#*$\s]+)*")
PACKAGE_URI = re.compile(r"(<mesh\b[^>]*?\bfilename\s*=\s*[\"']\s*)package://")
LATIN_DECLARATION = re.compile(
    rb"""<\?xml\b[^>]{0,200}?\bencoding\s*=\s*["'](iso-8859-15?|latin-?1|windows-1252)["']""", re.I
)
POLL_S = 0.02
GET_TIMEOUT_S = 1.0
STDIN_PATH = Path("standard input")
"""Stands for it in errors; what it includes is relative to the working folder."""


class RobotDescription(msgspec.Struct, frozen=True):
    """What to spawn."""

    text: str = ""
    """Empty when the server knows it by its uri."""
    uri: str = ""
    path: Path | None = None
    """The file that it was read from."""


def read_model_argument(
    model: str, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read what MODEL says: the path of a file, or the name of a shipped model.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
        DescriptionError: It cannot be read as text, or not expanded.
    """
    if Path(model).is_file():
        return read_description_file(Path(model), arguments, paths)
    if not NAME_PATTERN.fullmatch(model):
        raise FileNotFoundError(2, "no such file, nor a shipped model", model)
    return _read_shipped_model(model) or RobotDescription(uri=model)


def read_description_file(
    file: Path, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read a URDF, SDF or xacro file.

    Raises:
        OSError: There is none.
        DescriptionError: It is no text, or cannot be expanded.
        ServiceError: It is too large.
    """
    if (size := file.stat().st_size) > MAX_TEXT_BYTES:
        raise _too_large_error(f"{file} has {size} bytes")
    text = decode_description(file.read_bytes(), str(file))
    if is_xacro(text, file):
        text = expand_xacro(text, file, arguments, paths.beside(file))
    return RobotDescription(text, path=file)


def read_description_stream(
    stream: BinaryIO, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Read a URDF, SDF or xacro from standard input.

    Raises:
        DescriptionError: It is no text, or cannot be expanded.
        ServiceError: It is too large.
    """
    data = stream.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise _too_large_error(f"{STDIN_PATH} has more than {MAX_TEXT_BYTES} bytes")
    text = decode_description(data, str(STDIN_PATH))
    if is_xacro(text, STDIN_PATH):
        text = expand_xacro(text, STDIN_PATH, arguments, paths)
    return RobotDescription(text)


def _too_large_error(fault: str) -> ServiceError:
    return make_refusal(
        SpawnCode.RESOURCE_PARSE_ERROR,
        "xml.size",
        f"{fault}; a description has at most {MAX_TEXT_BYTES}",
    )


def decode_description(data: bytes, where: str) -> str:
    """Read bytes as XML says how: UTF-16 with its mark, a Latin that is declared, or UTF-8.

    Bytes of another encoding do no harm in comments.

    Raises:
        DescriptionError: They are none of these.
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
            f"{where} cannot be decoded: byte {error.start} is no {error.encoding}; use UTF-8"
        ) from error


def find_model_by_name(
    name: str, arguments: Mapping[str, str], paths: SearchPaths
) -> RobotDescription:
    """Find a model by name: in a folder of the search paths, or shipped.

    Raises:
        FileNotFoundError: There is none.
    """
    for folder in paths.package_folders(name):
        if (file := find_model_file(folder)) is not None:
            return read_description_file(file, arguments, paths)
    if NAME_PATTERN.fullmatch(name) and (found := _read_shipped_model(name)):
        return found
    raise FileNotFoundError(2, "no such model in GAZEBO_MODEL_PATH or shipped", name)


def _read_shipped_model(name: str) -> RobotDescription | None:
    shipped = resources.files("zensim.sim_server") / "models" / f"{name}.urdf"
    return (
        RobotDescription(shipped.read_text(encoding="utf-8"), name) if shipped.is_file() else None
    )


def receive_description(bus: Bus, key: str, timeout_s: float) -> RobotDescription:
    """Wait for a description on a key: one that is kept there, or the next that is put.

    Raises:
        ValueError: The key is none.
        TimeoutError: None came.
        DescriptionError: What came is no text.
    """
    bare = key.removeprefix("/")
    if not TOPIC_KEY.fullmatch(bare):
        raise ValueError(f"-topic {key[:80]!r} is no key; use one such as r1/robot_description")
    subscription = bus.subscribe(bare)
    deadline = time.monotonic() + timeout_s
    try:
        kept = bus.get(bare, min(timeout_s, GET_TIMEOUT_S))
        sample = kept[0] if kept else subscription.newest()
        while sample is None:
            if time.monotonic() >= deadline:
                raise TimeoutError(f"no description came on {bare} within {timeout_s:g} s")
            time.sleep(POLL_S)
            sample = subscription.newest()
    finally:
        subscription.close()
    return RobotDescription(_decode_message(sample))


def _decode_message(sample: Sample) -> str:
    data = sample.payload
    if data.lstrip()[:1] == b"<" or data[:3] == b"\xef\xbb\xbf":
        return decode_description(data, sample.key)
    try:
        return decode(String, data, sample.encoding).data
    except MalformedPayload as error:
        raise DescriptionError(f"what came on {sample.key} is no description: {error}") from error


def to_model_uris(description: RobotDescription) -> RobotDescription:
    """Write `model://` where meshes say `package://`."""
    text = PACKAGE_URI.sub(r"\1model://", description.text)
    return msgspec.structs.replace(description, text=text)
