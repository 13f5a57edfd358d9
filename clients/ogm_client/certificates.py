"""Certificates and keys that a Zenoh configuration names: Zenoh hardly says what is wrong with them."""

import json
import ssl
from collections.abc import Callable
from pathlib import Path

import zenoh

from ogm_core.errors import BadSetting

_PROTOCOLS = ("tls", "quic")


def check_certificates(settings: zenoh.Config, endpoints: str) -> None:
    """Refuse files of certificates and keys that are missing, none, or do not belong together.

    `endpoints`: those of the configuration, to listen on and to connect to; without TLS nothing is looked at.

    Raises:
        BadSetting: names the setting and the file, as seen from the folder that the program runs in.
    """
    if not speaks_tls(endpoints):
        return
    tls = json.loads(settings.get_json("transport/link/tls"))
    authority = _found(tls, "root_ca_certificate")
    if authority and not _read(ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT).load_verify_locations, authority):
        raise BadSetting(f"root_ca_certificate {authority}: certificates in PEM form are needed")
    for side in ("listen", "connect"):
        certificate, key = _found(tls, f"{side}_certificate"), _found(tls, f"{side}_private_key")
        load = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain
        if certificate and key and not _read(load, certificate, key, ""):
            raise BadSetting(
                f"{side}_private_key {key} is not the key of {side}_certificate {certificate}; both are "
                "needed in PEM form, the key without a password"
            )


def speaks_tls(endpoints: str) -> bool:
    """Whether one of the endpoints, given as text, needs certificates."""
    return any(f"{protocol}/" in endpoints for protocol in _PROTOCOLS)


def of_certificates(endpoints: str) -> str:
    """What else may be wrong where endpoints speak TLS, for the end of a sentence: Zenoh does not tell."""
    if not speaks_tls(endpoints):
        return ""
    return (
        "; with TLS each side needs a certificate that the other one's authority has signed, for its name, "
        "and not expired"
    )


def _found(tls: dict[str, str | None], name: str) -> str | None:
    """The path that a setting names, if any; its file can be read."""
    path = tls.get(name)
    try:
        if path is not None:
            Path(path).open("rb").close()
    except OSError as error:
        raise BadSetting(
            f"{name} {path}: {(error.strerror or str(error)).lower()}; the paths of a Zenoh configuration "
            f"count from the folder in which the program is started, here {Path.cwd()}"
        ) from error
    return path


def _read(load: Callable[..., None], *files: str) -> bool:
    """Whether OpenSSL reads these as certificates, or a certificate and its key; its other rules aside."""
    try:
        load(*files)
    except ssl.SSLError as error:
        return error.library == "SSL" and error.reason is not None
    return True
