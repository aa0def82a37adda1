"""<include> elements of SDF, replaced by the models that a resolver finds."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING

from zensim.proto.messages.asset_messages import parse_fuel_uri, resolve_include_uri
from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.element_rules import check_element, find_name
from zensim.sim_server.description.parsed_model import MODEL_FRAME
from zensim.sim_server.description.sdf.sdf_rules import (
    INCLUDE,
    MERGED_MODEL,
    MERGED_TAGS,
    SDF,
    VERSION_ATTRIBUTE,
)
from zensim.sim_server.description.sdf.sdf_values import read_text
from zensim.sim_server.description.strict_parsing import MAX_QUOTED_NAMES, parse_flag, quote
from zensim.sim_server.description.strict_xml import find_root_tag, parse_xml
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

ResolveInclude = Callable[[str], str | None]
"""Finds the SDF text of a URI; None when missing."""

SDF_VERSIONS = (
    "1.2", "1.3", "1.4", "1.5", "1.6", "1.7", "1.8", "1.9", "1.10", "1.11", "1.12",
)  # fmt: skip
OLDER_VERSIONS = ("1.0", "1.1")
"""Versions that have attributes where later ones have elements."""
MAX_NESTING = 16
"""Levels of nested models, included or not."""
MAX_INCLUDES = 5000
MAX_SDF_TAGS = 400_000
"""Tags of a document and of all its includes: the parser process reads them in 3 s with 150 MB."""
INCLUDABLE_TAGS = ("model", "light", "actor")


def no_includes(uri: str) -> str | None:  # noqa: ARG001  every resolver takes a URI
    """Return None: there are no models."""
    return None


def parse_sdf(text: str, report: ParseReport) -> Element:
    """Parse an SDF document and set its version on each of its models and worlds.

    Raises:
        ModelError: Not well-formed, too large, or of a version that is not read.
    """
    root_tag = "gazebo" if find_root_tag(text) == "gazebo" else "sdf"
    sdf = parse_xml(text, root_tag=root_tag, slug="sdf", max_tags=MAX_SDF_TAGS)
    version = (sdf.get("version") or "").strip()
    if version in OLDER_VERSIONS:
        raise ModelError(
            f"SDF {version} is not read; convert it to {SDF_VERSIONS[0]} or later, "
            "as with 'gz sdf -p FILE'",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug="sdf.version",
        )
    if version not in SDF_VERSIONS:
        report.suspicious(
            "sdf",
            f"unknown version {quote(version)}; known: {SDF_VERSIONS[0]} to {SDF_VERSIONS[-1]}",
        )
    check_element(sdf, SDF, sdf.tag, report)
    for owner in sdf.iter("model", "world"):
        owner.set(VERSION_ATTRIBUTE, version)
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
        self._missing: dict[str, None] = {}
        self._count = 0
        self._tags = 0

    def expand(self, owner: Element) -> None:
        """Expand the includes below a world or a model, in place.

        Raises:
            ModelError: Models are missing, one includes itself, or there are too many.
        """
        self._expand(owner, ())
        if self._missing and not self._allow_missing:
            raise ModelError(
                describe_missing_models(self._missing),
                code=SpawnCode.MISSING_ASSETS,
                slug="sdf.include",
            )

    def _expand(self, owner: Element, chain: tuple[str, ...], *, depth: int = 1) -> None:
        """Expand the includes below an owner.

        Args:
            owner: Changed in place.
            chain: URIs of the enclosing includes, outermost first.
            depth: Number of enclosing models, including the owner.
        """
        if depth > MAX_NESTING:
            raise ModelError(
                f"models are nested more than {MAX_NESTING} deep; use fewer levels",
                slug="sdf.nesting",
            )
        for child in list(owner):
            if child.tag == "model":
                self._expand(child, chain, depth=depth + 1)
            elif child.tag == "include":
                uri = read_text(child, "uri")
                if self._is_missing(uri):
                    owner.remove(child)
                    continue
                included = self._load_include(child, uri, chain)
                owner.replace(child, included)
                self._expand(included, (*chain, uri), depth=depth + 1)
                if parse_flag(child.get("merge")):
                    self._merge(included, owner, uri)

    def _is_missing(self, uri: str) -> bool:
        if uri in self._read or (uri and self._resolve(uri) is not None):
            return False
        if self._allow_missing:
            self._report.suspicious(f"include {quote(uri)}", "missing; left out")
        self._missing[uri] = None
        return True

    def _load_include(self, include: Element, uri: str, chain: tuple[str, ...]) -> Element:
        if uri in chain:
            raise ModelError(
                f"{quote(uri)} includes itself: {' > '.join(map(quote, chain[:5]))}",
                slug="sdf.include_cycle",
            )
        included = deepcopy(self._read_included(uri))
        self._count += 1
        self._tags += sum(1 for _ in included.iter())
        if self._count > MAX_INCLUDES or self._tags > MAX_SDF_TAGS:
            raise ModelError(
                f"{self._count} includes have {self._tags} tags; "
                f"use at most {MAX_INCLUDES} and {MAX_SDF_TAGS}",
                slug="sdf.size",
            )
        self._override(included, include, uri)
        self._report.applied(f"include {quote(uri)}")
        return included

    def _read_included(self, uri: str) -> Element:
        if uri in self._read:
            return self._read[uri]
        sdf = parse_sdf(self._resolve(uri) or "", self._report)
        found = [child for child in sdf if child.tag in INCLUDABLE_TAGS]
        if len(found) != 1:
            raise ModelError(
                f"{quote(uri)} contains {len(found)} models; use a file with one",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="sdf.model",
            )
        self._make_uris_absolute(found[0], uri)
        self._read[uri] = found[0]
        return found[0]

    def _make_uris_absolute(self, model: Element, uri: str) -> None:
        """Replace relative URIs, which would be equal for different files of two models."""
        for image in model.iter("albedo_map"):
            image.text = resolve_include_uri(uri, (image.text or "").strip())
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
        for written in (*include.findall("pose")[:1], *include.findall("static")[:1]):
            for old in model.findall(written.tag):
                model.remove(old)
            model.append(deepcopy(written))
        model.extend(deepcopy(include.findall("plugin")))
        check_element(include, INCLUDE, f"include {quote(uri)}", self._report)

    def _merge(self, model: Element, owner: Element, uri: str) -> None:
        """Replace an included model by its elements, which become elements of its owner.

        Source: SDFormat 1.9, merge-include.
        """
        links = model.findall("link")
        if owner.tag != "model" or model.tag != "model" or not links:
            self._report.suspicious(
                f"include {quote(uri)}: merge", "only models merge into models; read as one model"
            )
            return
        check_element(model, MERGED_MODEL, f"include {quote(uri)}: merged model", self._report)
        proxy = make_merge_frame(model)
        for element in [*model]:
            if find_name(element) in MERGED_TAGS:
                _rename_model_frame(element, proxy.get("name") or "")
                owner.insert(owner.index(model), element)
        owner.replace(model, proxy)


def describe_missing_models(uris: Iterable[str]) -> str:
    """Say in one line which models are missing, and what to download where."""
    named = list(uris)
    shown = ", ".join(map(quote, named[:MAX_QUOTED_NAMES]))
    more = f" and {len(named) - MAX_QUOTED_NAMES} more" if len(named) > MAX_QUOTED_NAMES else ""
    fuel = next((found.name for uri in named if (found := parse_fuel_uri(uri))), "")
    what = f"download it and put its folder {quote(fuel)}" if fuel else "put its folder"
    plural = f"{len(named)} included models are" if len(named) > 1 else "an included model is"
    return (
        f"{plural} missing: {shown}{more}; nothing is downloaded: {what} into a folder of "
        "--model-path (robots: --package-path), or allow missing models"
    )


def make_merge_frame(model: Element) -> Element:
    """Make the frame that stands for the frame of a merged model."""
    name = model.get("name") or ""
    proxy = model.makeelement("frame", {"name": f"_merged__{name}__frame"})
    canonical = model.get("canonical_link") or model.findall("link")[0].get("name") or ""
    proxy.set("attached_to", canonical)
    written = model.find("pose")
    pose = deepcopy(written) if written is not None else proxy.makeelement("pose", {})
    if not (pose.get("relative_to") or pose.get("frame")):
        pose.set("relative_to", MODEL_FRAME)
    if placement := (model.get("placement_frame") or "").strip():
        # The pose is that of the placement frame; the model's own frame follows from it.
        proxy.set("placement_frame", placement)
    proxy.append(pose)
    return proxy


def _rename_model_frame(element: Element, proxy: str) -> None:
    """Replace the model's frame, where an element names or implies it, by the proxy frame."""
    implied: tuple[str, ...] = (MODEL_FRAME,)
    if element.tag in ("link", "model"):
        implied = ("", MODEL_FRAME)
        if element.find("pose") is None:
            element.append(element.makeelement("pose", {}))
    if element.tag == "frame" and (element.get("attached_to") or "") in ("", MODEL_FRAME):
        element.set("attached_to", proxy)
    for owner, attribute in _list_frame_references(element):
        if (owner.get(attribute) or "") in implied:
            owner.set(attribute, proxy)
    for end in (*element.findall("parent"), *element.findall("child")):
        if (end.text or "").strip() == MODEL_FRAME:
            end.text = proxy


def _list_frame_references(element: Element) -> Iterator[tuple[Element, str]]:
    yield from ((pose, "relative_to") for pose in element.findall("pose"))
    for axis in (*element.findall("axis"), *element.findall("axis2")):
        yield from ((xyz, "expressed_in") for xyz in axis.findall("xyz"))
