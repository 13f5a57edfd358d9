"""`ogm`, which is also `python -m ogm_services`: the command line, unless its files may be another's."""

import sys
from importlib.metadata import PackageNotFoundError, version


def main() -> None:
    """Run the program.

    Not beside zenoh-ogm-client, whose files have the same names: whichever was installed last has written
    them, maybe those of another version. So nothing else of the project is loaded before this is known.
    """
    if _installed("zenoh-ogm-client"):
        sys.exit(
            "ogm: zenoh-ogm and zenoh-ogm-client are both installed and overwrite each other's files: "
            "run `pip uninstall zenoh-ogm zenoh-ogm-client`, then install one of the two"
        )
    from ogm_services import cli

    cli.main()


def _installed(distribution: str) -> bool:
    try:
        version(distribution)
    except PackageNotFoundError:
        return False
    return True


if __name__ == "__main__":
    main()
