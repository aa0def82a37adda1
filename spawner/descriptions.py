"""Where a description comes from: a file, a shipped model, a model folder, a stream, a key."""

import re
import time
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import BinaryIO

import msgspec

from zensim.proto.bus import Bus, Sample
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.proto.messages.standard_messages import String
from zensim.proto.names import NAME_PATTERN
from zensim.spawner.expansion import expanded, needs_expansion
from zensim.spawner.markup import MAX_TEXT_BYTES, DescriptionError, refused, without_comments
from zensim.spawner.search_paths import SearchPaths, model_file

KEY = re.compile(r"[^/?#*$\s]+(?:/[^/?#*$\s]+)*")
PACKAGE_URI = re.compile(r"(<mesh\b[^>]*?\bfilename\s*=\s*[\"']\s*)package://")
LATIN = re.compile(
    rb"""<\?xml\b[^>]{0,200}?\bencoding\s*=\s*["'](iso-8859-15?|latin-?1|windows-1252)["']""", re.I
)
POLL_S = 0.02
GET_TIMEOUT_S = 1.0
STREAM = Path("standard input")
"""Stands for it in errors; what it includes is relative to the working folder."""


class Description(msgspec.Struct, frozen=True):
    """What to spawn."""

    text: str = ""
    """Empty when the server knows it by its uri."""
    uri: str = ""
    path: Path | None = None
    """The file that it was read from."""


def from_word(model: str, arguments: Mapping[str, str], paths: SearchPaths) -> Description:
    """Read what MODEL says: the path of a file, or the name of a shipped model.

    Raises:
        FileNotFoundError: It looks like a path, but there is no such file.
        DescriptionError: It cannot be read as text, or not expanded.
    """
    if Path(model).is_file():
        return from_file(Path(model), arguments, paths)
    if not NAME_PATTERN.fullmatch(model):
        raise FileNotFoundError(2, "no such file, nor a shipped model", model)
    return _shipped(model) or Description(uri=model)


def from_file(file: Path, arguments: Mapping[str, str], paths: SearchPaths) -> Description:
    """Read a URDF, SDF or xacro file.

    Raises:
        OSError: There is none.
        DescriptionError: It is no text, or cannot be expanded.
        ServiceError: It is too large.
    """
    if (size := file.stat().st_size) > MAX_TEXT_BYTES:
        raise _too_large(f"{file} has {size} bytes")
    text = text_of(file.read_bytes(), str(file))
    if needs_expansion(text, file):
        text = expanded(text, file, arguments, paths.beside(file))
    return Description(text, path=file)


def from_stream(stream: BinaryIO, arguments: Mapping[str, str], paths: SearchPaths) -> Description:
    """Read a URDF, SDF or xacro from standard input.

    Raises:
        DescriptionError: It is no text, or cannot be expanded.
        ServiceError: It is too large.
    """
    data = stream.read(MAX_TEXT_BYTES + 1)
    if len(data) > MAX_TEXT_BYTES:
        raise _too_large(f"{STREAM} has more than {MAX_TEXT_BYTES} bytes")
    text = text_of(data, str(STREAM))
    if needs_expansion(text, STREAM):
        text = expanded(text, STREAM, arguments, paths)
    return Description(text)


def _too_large(fault: str) -> ServiceError:
    return refused(
        SpawnCode.RESOURCE_PARSE_ERROR,
        "xml.size",
        f"{fault}; a description has at most {MAX_TEXT_BYTES}",
    )


def text_of(data: bytes, where: str) -> str:
    """Read bytes as XML says how: UTF-16 with its mark, a Latin that is declared, or UTF-8.

    Bytes of another encoding do no harm in comments.

    Raises:
        DescriptionError: They are none of these.
    """
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        encoding = "utf-16"
    else:
        declared = LATIN.match(data)
        encoding = declared[1].decode().lower() if declared else "utf-8-sig"
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        text = data.decode(encoding, "replace")
        if encoding == "utf-8-sig" and "\ufffd" not in without_comments(text):
            return text
        raise DescriptionError(
            f"{where} cannot be decoded: byte {error.start} is no {error.encoding}; use UTF-8"
        ) from error


def from_database(name: str, arguments: Mapping[str, str], paths: SearchPaths) -> Description:
    """Find a model by name: in a folder of the search paths, or shipped.

    Raises:
        FileNotFoundError: There is none.
    """
    for folder in paths.package_folders(name):
        if (file := model_file(folder)) is not None:
            return from_file(file, arguments, paths)
    if NAME_PATTERN.fullmatch(name) and (found := _shipped(name)):
        return found
    raise FileNotFoundError(2, "no such model in GAZEBO_MODEL_PATH or shipped", name)


def _shipped(name: str) -> Description | None:
    shipped = resources.files("zensim.sim_server") / "models" / f"{name}.urdf"
    return Description(shipped.read_text(encoding="utf-8"), name) if shipped.is_file() else None


def from_topic(bus: Bus, key: str, timeout_s: float) -> Description:
    """Wait for a description on a key: one that is kept there, or the next that is put.

    Raises:
        ValueError: The key is none.
        TimeoutError: None came.
        DescriptionError: What came is no text.
    """
    bare = key.removeprefix("/")
    if not KEY.fullmatch(bare):
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
    return Description(_message_text(sample))


def _message_text(sample: Sample) -> str:
    data = sample.payload
    if data.lstrip()[:1] == b"<" or data[:3] == b"\xef\xbb\xbf":
        return text_of(data, sample.key)
    try:
        return decode(String, data, sample.encoding).data
    except MalformedPayload as error:
        raise DescriptionError(f"what came on {sample.key} is no description: {error}") from error


def with_model_uris(description: Description) -> Description:
    """Write `model://` where meshes say `package://`."""
    text = PACKAGE_URI.sub(r"\1model://", description.text)
    return msgspec.structs.replace(description, text=text)
