# SPDX-License-Identifier: GPL-3.0-or-later
"""Nobody comes in from another machine, nor another user from this one."""

from __future__ import annotations

import asyncio
import builtins
import ipaddress
import os
import shutil
import subprocess
import sys
import urllib.error
import urllib.request
from pathlib import Path

import pytest

from engine.cluster.pool import ClusterError

distributed = pytest.importorskip("distributed")
psutil = pytest.importorskip("psutil")
ROOT = Path(__file__).resolve().parents[3]


def listening(process_id):
    """Addresses and ports that a process and all that it started listen on."""
    process = psutil.Process(process_id)
    found = [one.net_connections(kind="inet") for one in (process, *process.children(recursive=True))]
    return [tuple(sock.laddr) for sockets in found for sock in sockets if sock.status == psutil.CONN_LISTEN]


def others(sockets):
    """Those that other machines reach."""
    return [address for address, _port in sockets if not ipaddress.ip_address(address).is_loopback]


@pytest.fixture(scope="module")
def pool():
    from engine.cluster.dask_pool import open_pool

    pool = open_pool("local:2", threads=1)
    yield pool
    pool.close()


def identify(address, security):
    """What whoever listens there says of itself."""

    async def ask():
        arguments = security.get_connection_args("client")
        async with distributed.rpc(address, connection_args=arguments, timeout=5) as remote:
            return await asyncio.wait_for(remote.identity(), 5)

    return asyncio.run(ask())


def test_a_local_cluster_listens_on_this_machine_only(pool):
    sockets = listening(os.getpid())
    # The scheduler, two workers, and Dask's pages of each.
    assert len(sockets) >= 6 and not others(sockets)


def test_a_local_cluster_answers_to_its_own_certificate_only(pool):
    from engine.cluster.encryption import shared_security, throwaway_certificate

    others_own = shared_security(*throwaway_certificate())
    for address in pool.workers():
        assert address.startswith("tls://127.0.0.1:")
        with pytest.raises((OSError, TimeoutError)):
            identify(address, others_own)
        with pytest.raises((OSError, TimeoutError)):
            identify(address.replace("tls://", "tcp://"), distributed.Security(require_encryption=False))


def test_a_local_cluster_shows_no_pages(pool):
    for address, port in listening(os.getpid()):
        for page in ("", "health", "info/main/workers.html", "json/identity.json", "metrics", "status"):
            with pytest.raises((urllib.error.URLError, OSError)):
                urllib.request.urlopen(f"http://{address}:{port}/{page}", timeout=5)


def test_certificates_are_made_by_what_is_there(monkeypatch):
    from engine.cluster.encryption import shared_security, throwaway_certificate

    plain_import = builtins.__import__

    def without_cryptography(name, *arguments, **options):
        if name.partition(".")[0] == "cryptography":
            raise ImportError(name)
        return plain_import(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", without_cryptography)
    if shutil.which("openssl"):
        one, another = throwaway_certificate(), throwaway_certificate()
        assert one != another
        shared_security(*one).get_connection_args("worker")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ClusterError, match="install the Python package cryptography"):
        throwaway_certificate()


@pytest.mark.parametrize("host", ["0.0.0.0", "0", "::", "192.0.2.1"])
def test_without_tls_workers_listen_to_this_machine_only(host):
    from engine.cluster.encryption import listening_host

    local = "tcp://127.0.0.1:9"
    with pytest.raises(ClusterError, match="--trust-network"):
        listening_host(local, host, trusts_network=False)
    with pytest.raises(ClusterError, match="--trust-network"):
        listening_host("127.0.0.1:9", host, trusts_network=False)
    assert listening_host(local, host, trusts_network=True) == host
    assert listening_host("tls://127.0.0.1:9", host, trusts_network=False) == host
    assert listening_host(local, None, trusts_network=False) == "127.0.0.1"
    assert listening_host(local, "localhost", trusts_network=False) == "localhost"


def test_the_workers_command_says_where_it_listens_and_keeps_to_it():
    with distributed.LocalCluster(
        n_workers=0, host="127.0.0.1", protocol="tcp://", dashboard_address="127.0.0.1:0"
    ) as cluster:
        command = [sys.executable, "-m", "engine.cluster", cluster.scheduler_address]
        refused = subprocess.run([*command, "--host", "0.0.0.0"], cwd=ROOT, capture_output=True, text=True, timeout=60)
        assert refused.returncode == 1 and "--trust-network" in refused.stderr
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as worker:
            try:
                said = worker.stdout.readline()
                sockets = listening(worker.pid)
            finally:
                worker.kill()
    assert "listens on tcp://127.0.0.1:" in said
    assert int(said.rpartition(":")[2]) in [port for _address, port in sockets] and not others(sockets)
