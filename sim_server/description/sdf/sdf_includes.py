"""<include> of SDF: each is replaced by the model that a resolver finds."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import resolve_include_uri
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.sdf.sdf_values import read_text
from zensim.sim_server.description.strict_parsing import parse_xml, quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

ResolveInclude = Callable[[str], str | None]
"""The SDF text that a URI stands for; None when it is not here."""

SDF_VERSIONS = ("1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "1.10", "1.11", "1.12")
VERSION_ATTRIBUTE = "sdf_version"
"""Attribute that every model gets: files of several versions may meet in one."""
MAX_NESTING = 16
"""Of models in models, included or not."""
MAX_INCLUDES = 2000
MAX_INCLUDED_TAGS = 400_000
"""Of all that is included."""
INCLUDE_TAGS = ("uri", "name", "pose", "static", "placement_frame", "plugin")


def no_includes(uri: str) -> str | None:  # noqa: ARG001  every Resolve takes a URI
    """Say that no model is here."""
    return None


def mark_versions(sdf: Element, report: ParseReport) -> Element:
    """Mark every model of a document with the document's version."""
    version = (sdf.get("version") or "").strip()
    if version not in SDF_VERSIONS:
        report.suspicious(
            "sdf",
            f"version {quote(version)}; read as one of {SDF_VERSIONS[0]} to {SDF_VERSIONS[-1]}",
        )
    for model in sdf.iter("model"):
        model.set(VERSION_ATTRIBUTE, version)
    return sdf


class IncludeExpander:
    """Puts models in the place of includes, below one document; equal URIs are read once."""

    def __init__(
        self, resolve: ResolveInclude, report: ParseReport, *, allow_missing: bool = False
    ) -> None:
        self._resolve = resolve
        self._report = report
        self._allow_missing = allow_missing
        self._read: dict[str, Element] = {}
        self._count = 0
        self._tags = 0

    def expand(self, owner: Element, chain: tuple[str, ...] = (), *, depth: int = 1) -> None:
        """Expand the includes below a world or a model.

        Args:
            owner: Changed in place.
            chain: URIs that are being included, outermost first.
            depth: How many models the owner is in, itself counted.

        Raises:
            ModelError: One is not here, includes itself, or there are too many.
        """
        if depth > MAX_NESTING:
            raise ModelError(
                f"models are nested more than {MAX_NESTING} deep; join some of them",
                slug="sdf.nesting",
            )
        for child in list(owner):
            if child.tag == "model":
                self.expand(child, chain, depth=depth + 1)
            elif child.tag == "include":
                uri = read_text(child, "uri")
                if self._is_left_out(uri):
                    owner.remove(child)
                    continue
                model = self._load_include(child, uri, chain)
                owner.replace(child, model)
                self.expand(model, (*chain, uri), depth=depth + 1)

    def _is_left_out(self, uri: str) -> bool:
        if not self._allow_missing or uri in self._read or self._resolve(uri) is not None:
            return False
        self._report.suspicious(f"include {quote(uri)}", "left out: it is not here")
        return True

    def _load_include(self, include: Element, uri: str, chain: tuple[str, ...]) -> Element:
        if uri in chain:
            raise ModelError(
                f"{quote(uri)} includes itself, by {' > '.join(map(quote, chain[:5]))}",
                slug="sdf.include_cycle",
            )
        model = deepcopy(self._read_model(uri))
        self._count += 1
        self._tags += sum(1 for _ in model.iter())
        if self._count > MAX_INCLUDES or self._tags > MAX_INCLUDED_TAGS:
            raise ModelError(
                f"{self._count} includes bring {self._tags} tags; "
                f"at most {MAX_INCLUDES} and {MAX_INCLUDED_TAGS} are read",
                slug="sdf.size",
            )
        self._override(model, include, uri)
        self._report.applied(f"include {quote(uri)}")
        return model

    def _read_model(self, uri: str) -> Element:
        if uri in self._read:
            return self._read[uri]
        text = self._resolve(uri) if uri else None
        if text is None:
            raise ModelError(
                f"it includes {quote(uri)}, which is not here; nothing is fetched: "
                "write the model out, or give the folder that it is in",
                code=SpawnCode.MISSING_ASSETS,
                slug="sdf.include",
            )
        sdf = mark_versions(parse_xml(text, root_tag="sdf", slug="sdf"), self._report)
        models = sdf.findall("model")
        if len(models) != 1:
            raise ModelError(
                f"{quote(uri)} holds {len(models)} models; one is needed",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.model",
            )
        self._make_uris_absolute(models[0], uri)
        self._read[uri] = models[0]
        return models[0]

    def _make_uris_absolute(self, model: Element, uri: str) -> None:
        """Write relative URIs out, so that those of two models are not mistaken for one another."""
        for tag in model.iter("mesh", "include"):
            written = tag.find("uri")
            if written is None:
                continue
            whole = resolve_include_uri(uri, (written.text or "").strip())
            # Includes have always been looked for below every folder, too.
            if tag.tag == "mesh" or self._resolve(whole) is not None:
                written.text = whole

    def _override(self, model: Element, include: Element, uri: str) -> None:
        for tag in ("name", "placement_frame"):
            if text := read_text(include, tag):
                model.set(tag, text)
        if include.get("merge") in ("true", "1"):
            self._report.suspicious(
                f"include {quote(uri)}: merge", "not supported; read as a model of its own"
            )
        for written in (*include.findall("pose")[:1], *include.findall("static")[:1]):
            for old in model.findall(written.tag):
                model.remove(old)
            model.append(written)
        model.extend(include.findall("plugin"))
        for child in include:
            if child.tag not in INCLUDE_TAGS:
                self._report.unread_tag(f"include {quote(uri)}", child.tag, INCLUDE_TAGS)
