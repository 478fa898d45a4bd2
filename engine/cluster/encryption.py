# SPDX-License-Identifier: GPL-3.0-or-later
"""Who may come in: certificates of a cluster, and the addresses that workers listen on.

Whatever reaches a worker's port has it run code. So workers listen where nobody else is, or ask for a certificate.
"""

from __future__ import annotations

import ipaddress
import os
import shutil
import socket
import subprocess
import tempfile
from pathlib import Path
from urllib.parse import urlsplit

from distributed import Security

from engine.cluster.pool import ClusterError

#: Where workers and scheduler of this machine listen.
LOOPBACK = "127.0.0.1"
#: What makes a certificate for one render; it needs no authority, since all who take part have the very same.
_OPENSSL = "req -x509 -newkey rsa:2048 -nodes -days 365 -subj /CN=neuralguide -keyout key.pem -out cert.pem".split()
#: What Dask is asked for where it finds no `cryptography`.
_NEITHER = "Cluster: a cluster on this machine needs a certificate: install the Python package cryptography, or openssl"


def throwaway_certificate() -> tuple[str, str]:
    """A certificate and its key, for those of one render; they are never in a file that others may read.

    Raises
    ------
    ClusterError
        If nothing here can make one.
    """
    try:
        made = Security.temporary()
    except ImportError:
        return _by_openssl()
    return made.tls_scheduler_cert, made.tls_scheduler_key


def _by_openssl() -> tuple[str, str]:
    program = shutil.which("openssl")
    if program is None:
        raise ClusterError(_NEITHER)
    # A folder of this user alone.
    with tempfile.TemporaryDirectory(prefix="neuralguide-") as name:
        folder = Path(name)
        try:
            subprocess.run([program, *_OPENSSL], cwd=folder, check=True, capture_output=True, timeout=60)
            return (folder / "cert.pem").read_text("ascii"), (folder / "key.pem").read_text("ascii")
        except (OSError, subprocess.SubprocessError) as error:
            said = getattr(error, "stderr", None) or b""
            raise ClusterError(f"{_NEITHER} ({error}) {said.decode(errors='replace').strip()}".strip()) from None


def shared_security(certificate: str, key: str) -> Security:
    """For all who have the same certificate, and nobody else."""
    return Security(
        require_encryption=True, tls_ca_file=certificate, tls_client_cert=certificate, tls_client_key=key,
        tls_scheduler_cert=certificate, tls_scheduler_key=key, tls_worker_cert=certificate, tls_worker_key=key,
    )


def check_encryption(address: str, role: str) -> None:
    """See whether Dask's configuration has what connecting there takes: Dask itself tries till its time is over.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    role : {'client', 'worker'}

    Raises
    ------
    ClusterError
        If something is missing.
    """
    security = Security()
    if not address.startswith("tls:"):
        if security.require_encryption and address.startswith("tcp:"):
            raise ClusterError(f"Cluster: Dask's configuration requires encryption: write tls:// instead of {address}")
        return
    tls = security.get_tls_config_for_role(role)
    for name, key, is_needed in (
        ("ca_file", "CA_FILE", True), ("cert", f"{role.upper()}__CERT", True), ("key", f"{role.upper()}__KEY", False),
    ):
        path, variable = tls.get(name), f"DASK_DISTRIBUTED__COMM__TLS__{key}"
        if not path and is_needed:
            raise ClusterError(f"Cluster: {address} asks for certificates, and {variable} names no file")
        # Dask takes certificates themselves, too.
        if path and "\n" not in path and not os.path.isfile(path):
            problem = f"{variable} names {path}: there is no such file"
            raise ClusterError(f"Cluster: {address} asks for certificates, and {problem}")
    try:
        security.get_connection_args(role)
    except (OSError, ValueError) as error:
        raise ClusterError(f"Cluster: the certificates for {address} cannot be used: {error}") from None


def listening_host(address: str, host: str | None, *, trusts_network: bool) -> str:
    """Where a worker of a scheduler listens.

    Parameters
    ----------
    address : str
        Address of the scheduler.
    host : str or None
        Address or name of this machine to listen on; None: the one that this machine reaches the scheduler from.
    trusts_network : bool
        Whether other machines may come in without TLS.

    Raises
    ------
    ClusterError
        If others could come in without a certificate.
    OSError
        If there is no such scheduler or host.
    """
    chosen = host or _address_towards(address)
    if not (address.startswith("tls:") or trusts_network or _is_loopback(chosen)):
        raise ClusterError(
            f"Cluster: a worker that listens on {chosen} without TLS runs what anybody on the network sends it: "
            "use tls:// with certificates (docs/farm.md), --host 127.0.0.1 where the scheduler is on this machine, "
            "or --trust-network"
        )
    return chosen


def _address_towards(address: str) -> str:
    """This machine's own address on the way to a scheduler."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    family, _, _, _, target = socket.getaddrinfo(parts.hostname, parts.port or 0, type=socket.SOCK_DGRAM)[0]
    # Nothing is sent.
    with socket.socket(family, socket.SOCK_DGRAM) as probe:
        probe.connect(target)
        return str(probe.getsockname()[0])


def _is_loopback(host: str) -> bool:
    """Whether nobody but this machine reaches it, by whatever address the name has."""
    found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    return all(ipaddress.ip_address(str(entry[4][0]).partition("%")[0]).is_loopback for entry in found)
