"""Connection of `ogm get` and `ogm status` to a mapper, as flags and settings say."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import ogm_client
from ogm_client.session import open_session
from ogm_core.wire.addresses import masked
from ogm_services.settings.settings import NetworkSettings


def address_of(url: str | None, network: NetworkSettings) -> str:
    """Where the mapper is looked for, in words."""
    config = network.for_client()
    return masked(url or ", ".join((*config.connect, *config.listen)) or str(config.config_file))


@contextmanager
def mapper_client(url: str | None, network: NetworkSettings) -> Iterator[ogm_client.MapClient]:
    """A client of the mapper at `url`, or else where `network` says; an HTTP address needs no `network`.

    Raises:
        BadSetting: the address, or the Zenoh configuration file, is ill-formed.
        CannotConnect, CannotListen: an address cannot be used.
    """
    # Who asks over HTTP need not know the map's name; one that was given is to be the map's.
    map_name = network.map_name if "map_name" in network.model_fields_set else None
    connect = network.for_client().connect if url is None else (url,)
    over_http = url is not None and url.startswith(("http://", "https://"))
    with ExitStack() as stack:
        if over_http or (len(connect) <= 1 and not network.listen):
            address = connect[0] if connect else None
            zenoh_config = None if over_http else network.zenoh_config
            client = ogm_client.MapClient(address, zenoh_config=zenoh_config, map_name=map_name)
        else:
            config = network.model_copy(update={"connect": connect}).for_client()
            session = stack.enter_context(open_session(config))
            client = ogm_client.MapClient(map_name=map_name, session=session)
        yield stack.enter_context(client)
