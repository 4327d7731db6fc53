"""The workers of a Dask cluster: an address in, a client whose workers have this version of the package out.

Dask is an optional dependency and is imported only when a cluster is used.
"""

from __future__ import annotations

import logging
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from ces_observer import __version__
from ces_observer.errors import CesError

CONNECT_S = 10.0


@contextmanager
def open_cluster(address: str) -> Iterator[Any]:
    """Open a client of the Dask scheduler at `address`; raises CesError without workers of this package's version."""
    client = _connect(import_dask(), address)
    try:
        _require_same_version(client, address)
        yield client
    finally:
        client.close()


def import_dask() -> Any:
    """Return dask.distributed with its log silenced, which would hide our one line about a lost cluster."""
    try:
        distributed = import_module("distributed")
    except ImportError:
        raise CesError("--dask needs dask.distributed: pip install 'ces_observer[dask]'") from None
    for handler in logging.getLogger("distributed").handlers:
        handler.setLevel(logging.CRITICAL + 1)
    return distributed


def _connect(distributed: Any, address: str) -> Any:
    """Return a client of the scheduler; a plain connection is tried first, as a failed client is slow to close."""
    host, _, port = address.rpartition("://")[2].rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), CONNECT_S):
            pass
        client = distributed.Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError, TypeError):
        raise CesError(
            f"--dask {address}: no scheduler answered within {CONNECT_S:g} s; expected the host:port of a running one"
        ) from None
    try:
        client.wait_for_workers(1, timeout=CONNECT_S)
    except OSError:
        client.close()
        raise CesError(f"--dask {address}: the scheduler has no workers; start some: dask worker {address}") from None
    return client


def _require_same_version(client: Any, address: str) -> None:
    try:
        versions = client.run(_version)
    except Exception as error:  # any error that keeps a worker from importing this module
        raise CesError(
            f"--dask {address}: its workers cannot run ces_identify; install ces_observer {__version__} there ({error})"
        ) from None
    for worker, version in versions.items():
        if version != __version__:
            raise CesError(f"--dask {address}: worker {worker} has ces_observer {version}; install {__version__} there")


def _version() -> str:
    return __version__
