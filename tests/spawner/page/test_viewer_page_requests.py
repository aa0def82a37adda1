"""Requests that the page accepts and refuses."""

import socket

import pytest

from zensim.spawner.page.viewer_page import is_own_origin

OWN = socket.gethostname().lower()


@pytest.mark.parametrize(
    ("host", "origin"),
    [
        ("127.0.0.1:8080", "http://127.0.0.1:8080"),
        ("localhost:9000", "http://localhost:9000"),
        ("[::1]:8080", "http://[::1]:8080"),
        ("192.168.1.5:8080", "http://192.168.1.5:8080"),
        (f"{OWN}:8080", f"http://{OWN}:8080"),
        ("sim.lab:8080", "http://sim.lab:8080"),
        ("SIM.lab:8080", "http://sim.LAB:8080"),
        ("127.0.0.1:8080", ""),
    ],
)
def test_request_of_the_own_page_is_accepted(host: str, origin: str) -> None:
    assert is_own_origin([host], [origin] if origin else [], bound_to="sim.lab")


@pytest.mark.parametrize(
    ("hosts", "origins"),
    [
        (["127.0.0.1:8080"], ["http://evil.example"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:3000"]),
        (["127.0.0.1:8080"], ["null"]),
        (["127.0.0.1:8080"], ["http://[::1"]),
        (["127.0.0.1:8080"], ["http://127.0.0.1:8080", "http://evil.example"]),
        (["evil.example:8080"], ["http://evil.example:8080"]),
        (["evil.example:8080"], []),
        (["127.0.0.1:8080; script-src *"], []),
        (["127.0.0.1:8080", "evil.example"], []),
        ([""], []),
        ([], []),
    ],
)
def test_request_of_another_page_is_refused(hosts: list[str], origins: list[str]) -> None:
    assert not is_own_origin(hosts, origins, bound_to="127.0.0.1")
