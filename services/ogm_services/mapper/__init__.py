"""The mapper: Zenoh in, Zenoh and HTTP out.

A scan's way: zenoh_side (callback), inbox, worker, mapper, the grid; and out again: view, answers, and the
Zenoh and HTTP sides.
"""
