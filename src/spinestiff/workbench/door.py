"""Who may come in: this machine alone, or whoever a reverse proxy with its own authentication lets through."""

from __future__ import annotations

import ipaddress
import re
import secrets
from pathlib import Path
from urllib.parse import urlsplit

from spinestiff.errors import OptionError
from spinestiff.files import read_text
from spinestiff.loopback.guard import HEADERS, Access, own_origins

OWN_HOSTS = ("127.0.0.1", "localhost")
FEWEST_SECRET = 32
BEHIND_PROXY = "proxy"
"""The token of a page behind a proxy: no secret, but a header that pages of other sites can't send."""
HARMLESS = ("/api/judge", "/api/propose", "/api/check", "/log", "/zip")
"""Ends of addresses that change nothing of a subject."""
SHOWN = "/shown/"
_WORKBENCH = {
    "content-security-policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; connect-src 'self'; "
        "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
}
# A report is a page of its own, with its own script: in a box, without this page's origin, without any request.
_SHOWN = {
    "content-security-policy": (
        "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; "
        "style-src 'unsafe-inline'; img-src 'self' data: blob:; base-uri 'none'; form-action 'none'; "
        "frame-ancestors 'self'"
    ),
    "x-frame-options": "SAMEORIGIN",
    # Browsers refuse a page in a box of its own window otherwise.
    "cross-origin-opener-policy": "unsafe-none",
}


def check_host(host: str, proxy: str | None) -> None:
    """Refuse an address that others can reach, unless a proxy checks who asks.

    Raises
    ------
    OptionError : no address, or one of others without a proxy.
    """
    try:
        address = ipaddress.ip_address("127.0.0.1" if host == "localhost" else host)
    except ValueError:
        raise OptionError(f"--host {host[:60]}: wanted an address of this machine, e.g. 127.0.0.1") from None
    if address.is_loopback and host not in OWN_HOSTS and proxy is None:
        raise OptionError(f"--host {host}: wanted {' or '.join(OWN_HOSTS)}, or the address of another network card")
    if not address.is_loopback and proxy is None:
        raise OptionError(
            f"--host {host}: others could reach it, and this program has no accounts; wanted 127.0.0.1, or a reverse "
            "proxy with its own authentication in front, named by --proxy and --proxy-secret (docs/workbench.md)"
        )


def access_of(port: int, proxy: str | None, secret_file: Path | None, read_only: bool) -> Access:
    """Who may ask a workbench at this port.

    Parameters
    ----------
    proxy : origin of the reverse proxy, as browsers see it; None: this machine alone.
    secret_file : holds what the proxy adds to each request as a header.

    Raises
    ------
    OptionError : one without the other, no origin, a secret that is too short.
    """
    if (proxy is None) != (secret_file is None):
        raise OptionError("--proxy and --proxy-secret belong together; give both or none of them")
    origins, secret, token = own_origins(port), None, secrets.token_urlsafe(32)
    if proxy is not None and secret_file is not None:
        host, origin = _host_and_origin(proxy)
        origins, token = {host: origin}, BEHIND_PROXY
        secret = read_text(secret_file).strip()
        if len(secret) < FEWEST_SECRET or not secret.isascii() or not secret.isprintable():
            raise OptionError(f"--proxy-secret {secret_file}: wanted at least {FEWEST_SECRET} printable characters")
    headers = ((SHOWN, _SHOWN), ("/annotate/", HEADERS), ("/", _WORKBENCH))
    return Access(token, origins, headers, read_only, HARMLESS, secret, "spinestiff serve")


def _host_and_origin(proxy: str) -> tuple[str, str]:
    """As browsers send them: in small letters, and without the port that is the usual one."""
    try:
        parts = urlsplit(proxy)
    except ValueError:  # half of an IPv6 address
        parts = urlsplit("")
    beyond = parts.path not in ("", "/") or parts.query or parts.fragment
    if parts.scheme not in ("http", "https") or not parts.netloc or beyond:
        raise OptionError(f"--proxy {proxy[:80]}: wanted an origin, e.g. https://spine.example.org")
    if not re.fullmatch(r"[A-Za-z0-9.-]+(:[0-9]+)?", parts.netloc):
        raise OptionError(f"--proxy {proxy[:80]}: wanted a host, and perhaps a port")
    host = parts.netloc.lower().removesuffix(":443" if parts.scheme == "https" else ":80")
    return host, f"{parts.scheme}://{host}"
