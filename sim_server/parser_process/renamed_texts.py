"""Texts that differ in the robot's name and namespace alone: the others are copies of the first."""

import re
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

import msgspec

from zensim.proto.messages.model_messages import Model
from zensim.proto.names import NAME_PATTERN, RESERVED_NAMES
from zensim.sim_server.parser_process.parser_protocol import ParseRequest, ParseResult

ROOT_NAME = re.compile(r'\s*(?:<\?xml[^<>]*\?>\s*)?<robot\s+name="(\w+)"', re.ASCII)
NAMESPACE = re.compile(r"<namespace>/?(\w+)</namespace>", re.ASCII)
NAME_MARK, NAMESPACE_MARK = "zensimNameMark".ljust(64, "0"), "zensimNamespaceMark".ljust(64, "0")
"""Valid names that no description has."""
MAX_TEXT_CHARACTERS = 1 << 18
"""Characters of a text and the texts of its controllers."""
MAX_PARSING_S = 1.0
"""CPU time of a text that is parsed twice: both count against the limits of one."""
FORMAT_WORDS = frozenset({"true", "false"})
"""Names that are also values of elements, which a mark must not replace."""
MAX_FORMS = 32
"""Descriptions of which copies are made."""


@dataclass(frozen=True)
class NamedText:
    """A text whose name and namespace are marks, and what they stand for; empty = has none."""

    form: str
    name: str
    namespace: str

    def rename(self, encoded: bytes) -> bytes:
        """Replace the marks in an encoded model."""
        named = encoded.replace(NAME_MARK.encode(), self.name.encode())
        return named.replace(NAMESPACE_MARK.encode(), self.namespace.encode())


def split_names(text: str) -> NamedText:
    """Replace the name of the root element, and the first namespace wherever it is, by marks.

    Only names that stand alone are replaced: between slashes, or as the whole text of an element.
    """
    name, namespace = ROOT_NAME.match(text), NAMESPACE.search(text)
    own = name[1] if name is not None and _is_replaceable(name[1]) else ""
    form = text
    if name is not None and own:
        form = text[: name.start(1)] + NAME_MARK + text[name.end(1) :]
    if namespace is None or not _is_replaceable(namespace[1]):
        return NamedText(form, own, "")
    alone = rf"(?<=[/>]){namespace[1]}(?=[/<])"
    return NamedText(re.sub(alone, NAMESPACE_MARK, form), own, namespace[1])


def _is_replaceable(name: str) -> bool:
    is_name = NAME_PATTERN.fullmatch(name) is not None
    return is_name and name not in RESERVED_NAMES and name not in FORMAT_WORDS


ParsedText = tuple[ParseResult, dict[str, bytes]]
"""A result, and the meshes that were made for it by sha256."""


class RenamedTexts:
    """Parses texts; of those that differ in their names alone, the first two.

    The second one decides: the model of the text with marks, renamed, must equal its own model.
    Where a name has another effect, or meshes are made, each text is parsed.
    """

    def __init__(
        self,
        parse: Callable[[ParseRequest], ParsedText],
        read_cpu_s: Callable[[], float] = time.process_time,
    ) -> None:
        self._parse = parse
        self._read_cpu_s = read_cpu_s
        self._models: OrderedDict[ParseRequest, bytes | None] = OrderedDict()
        """Encoded models by request with marks; empty before the second text, None = differs."""
        self._unchecked: tuple[ParseRequest, NamedText, ParseResult] | None = None
        """Result of the last text, if it is the second of its form."""

    def parse(self, request: ParseRequest) -> ParsedText:
        """Parse a text, or copy the model of one that differs in its names alone."""
        size = len(request.text) + sum(map(len, request.controllers))
        if request.is_world or request.assets or size > MAX_TEXT_CHARACTERS:
            return self._parse(request)
        text = split_names(request.text)
        if text.form == request.text or NAME_MARK in request.text or NAMESPACE_MARK in request.text:
            return self._parse(request)
        form = msgspec.structs.replace(request, number=0, text=text.form)
        if model := self._models.get(form):
            self._models.move_to_end(form)
            return ParseResult(request.number, _decode(text.rename(model))), {}
        began_s = self._read_cpu_s()
        result, meshes = self._parse(request)
        is_slow = self._read_cpu_s() - began_s > MAX_PARSING_S
        if form not in self._models:
            self._models[form] = b""
            if len(self._models) > MAX_FORMS:
                self._models.popitem(last=False)
        elif self._models[form] is not None:
            self._models[form] = None
            if not (meshes or is_slow):
                self._unchecked = form, text, result
        return result, meshes

    def check(self) -> None:
        """Find out whether later texts may be copies of the last one; call it after its reply."""
        unchecked, self._unchecked = self._unchecked, None
        if unchecked is not None:
            self._models[unchecked[0]] = self._encode_marked(*unchecked)

    def _encode_marked(
        self, form: ParseRequest, text: NamedText, result: ParseResult
    ) -> bytes | None:
        """Encode the model of a text with marks; None if a name has another effect."""
        marked = self._parse(form)[0].model
        if marked is None or result.model is None:
            return None
        encoded = msgspec.json.encode(marked)
        try:
            is_same = _decode(text.rename(encoded)) == result.model
        except msgspec.ValidationError:  # JSON has no infinite numbers
            return None
        return encoded if is_same else None


def _decode(encoded: bytes) -> Model:
    return msgspec.json.decode(encoded, type=Model)
