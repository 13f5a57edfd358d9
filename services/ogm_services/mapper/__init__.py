"""The mapper: Zenoh in, Zenoh and HTTP out.

A scan's way: intake (callback, queue, worker), the scan placer, the live map; and out again: snapshots,
answers, and the routes of HTTP and Zenoh.
"""
