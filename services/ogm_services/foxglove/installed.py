"""The extra `foxglove`: whether it is installed, found out before anything is opened."""

from ogm_core.errors import MissingExtra


def check_installed() -> None:
    """Find out whether the bridge can run.

    Raises:
        MissingExtra: it cannot.
    """
    try:
        import foxglove
        import rosbags
    except ImportError as error:
        raise MissingExtra(
            "ogm foxglove needs foxglove-sdk and rosbags: pip install 'zenoh-ogm[foxglove]'"
        ) from error
    del foxglove, rosbags
