"""Where a process can be talked to from other machines."""

from __future__ import annotations

import ipaddress


def open_ports() -> list[str]:
    """The addresses, as "0.0.0.0:8786", on which this process listens beyond its machine. Needs psutil, as Dask."""
    import psutil

    process = psutil.Process()
    # older versions of psutil have the other name only
    connections = getattr(process, "net_connections", None) or process.connections
    listening = (each.laddr for each in connections("tcp") if each.status == psutil.CONN_LISTEN)
    return sorted({f"{at.ip}:{at.port}" for at in listening if not is_loopback(at.ip)})


def is_loopback(host: str) -> bool:
    """Whether a host's name or address is one that only this machine reaches."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
