"""What a server and a deployment listen on by default: loopback only, and no multicast."""

import socket

import psutil

from tests.integration.processes import children, running_up


def test_default_deployment_listens_on_loopback_only() -> None:
    with running_up("--robots", "1", "--viewer-port", "0") as (process, _, _):
        family = [psutil.Process(pid) for pid in (process.pid, *children(process.pid))]
        found = [one for program in family for one in program.net_connections("inet")]

    listening = {one.laddr.ip for one in found if one.status == psutil.CONN_LISTEN}
    datagrams = {one.laddr.ip for one in found if one.type == socket.SOCK_DGRAM}
    assert listening == {"127.0.0.1"}
    assert datagrams <= {"127.0.0.1"}
