"""A building of nothing but corridors: what a map costs that is long, thin and mostly empty."""

import math
from collections.abc import Iterator

import numpy as np

from benchmarks.workloads import Workload, simulated
from ogm_core.simulation.lidar import Lidar
from ogm_core.simulation.trajectories import Point, WaypointPath
from ogm_core.simulation.worlds import World

BLOCKS, SPACING, WIDTH, STEP = 5, 15.0, 2.5, 1.0
"""Blocks along a side of the building; way between crossings, width of a corridor, the robot's step: m."""
BEAMS, FOV, RANGE_MAX = 541, math.radians(270.0), 10.0

Node = tuple[int, int]
EAST, NORTH, WEST, SOUTH = DIRECTIONS = (1, 0), (0, 1), (-1, 0), (0, -1)


def corridors(seed: int = 1) -> Workload:
    """One lap through a closed corridor of 1500 m, 2.5 m wide, which is folded into 140 x 140 m.

    The building stands askew on the lattice, as buildings do.
    """
    rng = np.random.default_rng(seed)
    loop = closed_corridor(rng)
    world = building(loop, rng.uniform(0.0, math.pi / 2.0))
    lap = [world.path.pose(k) for k in range(world.path.count)]
    lidar = Lidar(beams=BEAMS, fov=FOV, range_max=RANGE_MAX, noise=0.02)
    return Workload("corridors", simulated(world, lap, lidar, rng), resolution=0.05, alpha=0.1)


def closed_corridor(rng: np.random.Generator) -> list[Node]:
    """Crossings, BLOCKS * BLOCKS * 4 of them, in the order in which a robot meets each once: a closed way.

    It goes round a random tree that joins the blocks, each of 2 x 2 crossings, and keeps it on its left.
    """
    joined = random_tree(rng)
    way, node, heading = [(0, 0)], (0, 0), EAST
    while True:
        heading = next(turn for turn in turns(heading) if is_open(node, turn, joined))
        node = node[0] + heading[0], node[1] + heading[1]
        if node == way[0]:
            return way
        way.append(node)


def random_tree(rng: np.random.Generator) -> set[frozenset[Node]]:
    """Pairs of neighbouring blocks that are joined: all of them to one tree."""
    pairs = [
        frozenset(((x, y), (x + dx, y + dy)))
        for x in range(BLOCKS)
        for y in range(BLOCKS)
        for dx, dy in (EAST, NORTH)
        if x + dx < BLOCKS and y + dy < BLOCKS
    ]
    tree_of = {(x, y): {(x, y)} for x in range(BLOCKS) for y in range(BLOCKS)}
    joined = set()
    for k in rng.permutation(len(pairs)):
        one, other = pairs[k]
        if tree_of[one] is not tree_of[other]:
            joined.add(pairs[k])
            tree_of[one] |= tree_of[other]
            tree_of |= dict.fromkeys(tree_of[other], tree_of[one])
    return joined


def turns(heading: Node) -> Iterator[Node]:
    """Headings from the right to the left of one: the way back is never needed."""
    k = DIRECTIONS.index(heading)
    return (DIRECTIONS[(k + turn) % 4] for turn in (-1, 0, 1))


def is_open(node: Node, heading: Node, joined: set[frozenset[Node]]) -> bool:
    """Whether the way round the tree may go from a crossing to the next one in this direction."""
    after = node[0] + heading[0], node[1] + heading[1]
    here, there = (node[0] // 2, node[1] // 2), (after[0] // 2, after[1] // 2)
    if here != there:
        return frozenset((here, there)) in joined
    # Within a block: unless the tree leaves the block between the two crossings.
    side = _side_of(node, heading)
    return frozenset((here, (here[0] + side[0], here[1] + side[1]))) not in joined


def _side_of(node: Node, heading: Node) -> Node:
    """The side of its block on which a step from this crossing to another one of the block is made."""
    if heading[0]:
        return NORTH if node[1] % 2 else SOUTH
    return EAST if node[0] % 2 else WEST


def building(loop: list[Node], askew: float) -> World:
    """The walls of a corridor along a closed way, and the way as the robot's path; turned by `askew`, rad."""
    c, s = math.cos(askew), math.sin(askew)

    def placed(x: float, y: float) -> Point:
        return c * x - s * y, s * x + c * y

    open_to: dict[Node, set[Node]] = {node: set() for node in loop}
    for node, after in zip(loop, [*loop[1:], loop[0]], strict=True):
        step = after[0] - node[0], after[1] - node[1]
        open_to[node].add(step)
        open_to[after].add((-step[0], -step[1]))
    walls = [
        (*placed(*start), *placed(*end))
        for node, steps in open_to.items()
        for start, end in _walls_at(node, steps)
    ]
    path = WaypointPath(tuple(placed(SPACING * x, SPACING * y) for x, y in loop), STEP)
    return World("corridors", np.zeros((0, 3)), np.array(walls), path)


def _walls_at(node: Node, steps: set[Node]) -> Iterator[tuple[Point, Point]]:
    """Walls around a crossing: both sides of a corridor up to its middle, or what closes a side."""
    half, x, y = WIDTH / 2.0, SPACING * node[0], SPACING * node[1]
    for dx, dy in DIRECTIONS:
        corners = [(x + half * (dx - turn * dy), y + half * (dy + turn * dx)) for turn in (-1, 1)]
        if (dx, dy) not in steps:
            yield corners[0], corners[1]
            continue
        for px, py in corners:
            way = SPACING / 2.0 - half
            yield (px, py), (px + way * dx, py + way * dy)
