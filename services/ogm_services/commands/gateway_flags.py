"""The command `ogm gateway` and its flags; what it does is loaded when it runs."""

from ogm_services.runtime.kernel_cache import kernel_cache
from ogm_services.runtime.loading import loading
from ogm_services.runtime.logged_service import logged_service
from ogm_services.settings.flag_groups import with_flag_groups
from ogm_services.settings.flags import (
    ConfigFile,
    HttpFlags,
    LoggingFlags,
    MapFlags,
    NetworkFlags,
    PrintConfig,
    settings_from,
)
from ogm_services.settings.keeping_flags import GatewayFlags
from ogm_services.settings.robot_flags import SensorFlags


@with_flag_groups
def gateway(
    map_flags: MapFlags,
    shares: GatewayFlags,
    network: NetworkFlags,
    http: HttpFlags,
    logging: LoggingFlags,
    config: ConfigFile = None,
    print_config: PrintConfig = False,
    sensor: SensorFlags = None,
) -> None:
    """Serve the map of all mappers that share it, as one mapper would, over Zenoh and HTTP."""
    groups = map_flags, shares, network, http, logging
    settings = settings_from(config, *groups, sensors=sensor, print_config=print_config)
    with logged_service(*settings.log.as_given), kernel_cache():
        with loading():
            from ogm_services.mapper.gateway.gateway_service import run_gateway
        run_gateway(settings)
