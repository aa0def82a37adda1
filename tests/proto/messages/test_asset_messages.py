"""Relative URIs in included models."""

import pytest

from zensim.proto.messages.asset_messages import resolve_include_uri


@pytest.mark.parametrize(
    ("include", "uri", "whole"),
    [
        ("model://crate", "meshes/a.stl", "model://crate/meshes/a.stl"),
        ("model://crate/", "meshes/a.stl", "model://crate/meshes/a.stl"),
        ("model://crate/model.sdf", "a.stl", "model://crate/a.stl"),
        ("parts/crate.sdf", "../a.stl", "parts/../a.stl"),
        ("crate.sdf", "a.stl", "a.stl"),
        ("", "a.stl", "a.stl"),
        ("model://crate", "model://other/a.stl", "model://other/a.stl"),
        ("model://crate", "/opt/a.stl", "/opt/a.stl"),
        ("model://crate", "//meshes/a.stl", "model://crate/meshes/a.stl"),
        ("model://crate", "", ""),
    ],
)
def test_relative_uri_is_relative_to_the_included_model(include: str, uri: str, whole: str) -> None:
    assert resolve_include_uri(include, uri) == whole
