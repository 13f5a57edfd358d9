"""A Zenoh router, a process that can be killed: `python -m tests.soak.router ENDPOINT`."""

import sys
import threading

import zenoh


def main(endpoint: str) -> None:
    """Route until the end."""
    scouting = "scouting: {multicast: {enabled: false}, gossip: {enabled: false}}"
    config = zenoh.Config.from_json5(f'{{mode: "router", listen: {{endpoints: ["{endpoint}"]}}, {scouting}}}')
    with zenoh.open(config):
        print("routing", flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
