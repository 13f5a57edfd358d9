"""Connection of `ogm get`, `ogm status` and `ogm snapshot` to a mapper, as flags and settings say."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import Any

import ogm_client
from ogm_client import MapperError
from ogm_client.session import open_session
from ogm_core.errors import BadParameter
from ogm_core.wire.addresses import masked
from ogm_services.settings.settings import NetworkSettings

WRONG_NAMES = ("unknown-snapshot", "name-taken")
"""Refusals of a name of a saved map."""
_BAD_REQUEST = 400


def address_of(url: str | None, network: NetworkSettings) -> str:
    """Where the mapper is looked for, in words."""
    config = network.for_client()
    return masked(url or ", ".join((*config.connect, *config.listen)) or str(config.config_file))


@contextmanager
def asking() -> Iterator[None]:
    """What a mapper finds wrong with a request is what the user gave.

    Raises:
        BadParameter: in place of such a MapperError.
    """
    try:
        yield
    except MapperError as error:
        if error.status == _BAD_REQUEST or error.type in WRONG_NAMES:
            raise BadParameter(error.detail) from None
        raise


def is_http(url: str | None) -> bool:
    """Whether a mapper is asked over HTTP there, and not over Zenoh."""
    return url is not None and url.startswith(("http://", "https://"))


@contextmanager
def mapper_client(
    url: str | None,
    network: NetworkSettings,
    **options: Any,  # noqa: ANN401 (MapClient's)
) -> Iterator[ogm_client.MapClient]:
    """A client of the mapper at `url`, or else where `network` says; an HTTP address needs no `network`.

    `options` are those of `MapClient`.

    Raises:
        BadSetting: the address, or the Zenoh configuration file, is ill-formed.
        CannotConnect, CannotListen: an address cannot be used.
    """
    # Who asks over HTTP need not know the map's name; one that was given is to be the map's.
    map_name = network.map_name if "map_name" in network.model_fields_set else None
    connect = network.for_client().connect if url is None else (url,)
    over_http = is_http(url)
    with ExitStack() as stack:
        if over_http or (len(connect) <= 1 and not network.listen):
            address = connect[0] if connect else None
            zenoh_config = None if over_http else network.zenoh_config
            client = ogm_client.MapClient(address, zenoh_config=zenoh_config, map_name=map_name, **options)
        else:
            config = network.model_copy(update={"connect": connect}).for_client()
            session = stack.enter_context(open_session(config))
            client = ogm_client.MapClient(map_name=map_name, session=session, **options)
        yield stack.enter_context(client)
