"""<include> elements of SDF, replaced by the models that a resolver finds."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import resolve_include_uri
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.sdf.sdf_values import read_text
from zensim.sim_server.description.strict_parsing import parse_flag, parse_xml, quote
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

ResolveInclude = Callable[[str], str | None]
"""Finds the SDF text of a URI; None when missing."""

SDF_VERSIONS = ("1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "1.10", "1.11", "1.12")
VERSION_ATTRIBUTE = "sdf_version"
"""Set on each model, since a model may include models of other versions."""
MAX_NESTING = 16
"""Of models, included or not."""
MAX_INCLUDES = 2000
MAX_INCLUDED_TAGS = 400_000
"""Of all includes."""
INCLUDE_TAGS = ("uri", "name", "pose", "static", "placement_frame", "plugin")


def no_includes(uri: str) -> str | None:  # noqa: ARG001  every resolver takes a URI
    """Return None: there are no models."""
    return None


def mark_versions(sdf: Element, report: ParseReport) -> Element:
    """Set the version of a document on each of its models."""
    version = (sdf.get("version") or "").strip()
    if version not in SDF_VERSIONS:
        report.suspicious(
            "sdf",
            f"unknown version {quote(version)}; known: {SDF_VERSIONS[0]} to {SDF_VERSIONS[-1]}",
        )
    for model in sdf.iter("model"):
        model.set(VERSION_ATTRIBUTE, version)
    return sdf


class IncludeExpander:
    """Replaces the includes of one document; equal URIs are read once."""

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
            chain: URIs of the enclosing includes, outermost first.
            depth: Number of enclosing models, including the owner.

        Raises:
            ModelError: A model is missing, includes itself, or there are too many.
        """
        if depth > MAX_NESTING:
            raise ModelError(
                f"models are nested more than {MAX_NESTING} deep; use fewer levels",
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
        self._report.suspicious(f"include {quote(uri)}", "missing; left out")
        return True

    def _load_include(self, include: Element, uri: str, chain: tuple[str, ...]) -> Element:
        if uri in chain:
            raise ModelError(
                f"{quote(uri)} includes itself: {' > '.join(map(quote, chain[:5]))}",
                slug="sdf.include_cycle",
            )
        model = deepcopy(self._read_model(uri))
        self._count += 1
        self._tags += sum(1 for _ in model.iter())
        if self._count > MAX_INCLUDES or self._tags > MAX_INCLUDED_TAGS:
            raise ModelError(
                f"{self._count} includes have {self._tags} tags; "
                f"use at most {MAX_INCLUDES} and {MAX_INCLUDED_TAGS}",
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
                f"the included model {quote(uri)} is missing and not downloaded; "
                "replace the include by the model, or add its folder",
                code=SpawnCode.MISSING_ASSETS,
                slug="sdf.include",
            )
        sdf = mark_versions(parse_xml(text, root_tag="sdf", slug="sdf"), self._report)
        models = sdf.findall("model")
        if len(models) != 1:
            raise ModelError(
                f"{quote(uri)} contains {len(models)} models; use a file with one",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.model",
            )
        self._make_uris_absolute(models[0], uri)
        self._read[uri] = models[0]
        return models[0]

    def _make_uris_absolute(self, model: Element, uri: str) -> None:
        """Replace relative URIs, which would be equal for different files of two models."""
        for tag in model.iter("mesh", "include"):
            written = tag.find("uri")
            if written is None:
                continue
            whole = resolve_include_uri(uri, (written.text or "").strip())
            # A relative include may also exist below another folder.
            if tag.tag == "mesh" or self._resolve(whole) is not None:
                written.text = whole

    def _override(self, model: Element, include: Element, uri: str) -> None:
        for tag in ("name", "placement_frame"):
            if text := read_text(include, tag):
                model.set(tag, text)
        if parse_flag(include.get("merge")):
            self._report.suspicious(
                f"include {quote(uri)}: merge", "not supported; read as a nested model"
            )
        for written in (*include.findall("pose")[:1], *include.findall("static")[:1]):
            for old in model.findall(written.tag):
                model.remove(old)
            model.append(written)
        model.extend(include.findall("plugin"))
        for child in include:
            if child.tag not in INCLUDE_TAGS:
                self._report.unread_tag(f"include {quote(uri)}", child.tag, INCLUDE_TAGS)
