"""Gathered map: the parts of shares, pasted together, are the map that one mapper would have."""

import contextlib
import hashlib
from dataclasses import replace

import numpy as np
import pytest

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.errors import BadMessage, LimitReached
from ogm_core.files.map_files import encode_npz, encode_pgm
from ogm_core.grid import OccupancyGrid
from ogm_core.grid_settings import GridSettings
from ogm_core.lattice import CellRect, Lattice
from ogm_core.shares import Cuts
from ogm_core.tiles.changes import ChangedTiles
from ogm_core.types import Pose
from ogm_services.mapper.shares.gathered_map import GatheredMap, OtherMap
from ogm_services.mapper.shares.layout import ShareLayout
from ogm_services.mapper.shares.share_parts import MissingShare
from shares_desk import FOUR, SETTINGS, FakeShare, scan_at

SECOND = 10**9


def cut(x=(), y=()):
    return ShareLayout.of(Cuts(x, y), Lattice(0.05))


class Fleet:
    """Four shares, the mapper that they stand for, and a gateway."""

    def __init__(self, settings=SETTINGS, layout=FOUR, period=1_000):
        self.settings, self.layout, self.period = settings, layout, period
        self.one = OccupancyGrid(settings, "one", "run")
        self.shares = [FakeShare(k, settings, layout) for k in range(layout.count)]
        self.gathered = GatheredMap(settings, layout, "g")
        self.rng = np.random.default_rng(1)
        self.scans = 0

    def integrate(self, count=1, shares=None):
        for _ in range(count):
            scan, pose = scan_at(self.scans, self.rng)
            placed = replace(scan, stamp=self.period * (self.scans + 1)), pose
            self.scans += 1
            self.one.integrate(*placed)
            for share in self.shares if shares is None else shares:
                share.integrate(*placed)

    def gather(self, *which):
        for k in which or range(self.layout.count):
            part = self.gathered.state.parts[k]
            mine = self.shares[k].state
            same = part is not None and (part.epoch, part.run) == (mine.epoch, mine.run)
            self.gathered.take(k, self.shares[k].updates(part.revision if same else None))
        return self.gathered.state


@pytest.mark.parametrize("layout", [FOUR, cut((-3.2,)), cut((-6.4, 3.2), (0.0, 3.2))])
def test_parts_of_shares_are_the_map_of_one_mapper_byte_for_byte(layout):
    fleet = Fleet(layout=layout)
    for _ in range(6):
        fleet.integrate(4)
        state = fleet.gather()
        whole = fleet.one.snapshot()
        for snapshot in (fleet.gathered.told(state), fleet.gathered.followed(state)):
            assert encode_npz(snapshot) == encode_npz(whole)
            assert snapshot.stamp == whole.stamp


def test_shares_forget_as_one_mapper_does_for_each_has_the_time_of_every_scan():
    fleet = Fleet(replace(SETTINGS, cell_model=Rate(), half_life=1.0), period=SECOND // 4)
    for _ in range(4):
        fleet.integrate(5)
        whole, gathered = fleet.one.snapshot().finest(), fleet.gathered.told(fleet.gather()).finest()
        assert encode_npz(gathered) == encode_npz(whole)
    assert len(fleet.one.time.ticks) > 2


def test_shares_that_call_less_free_are_gathered_by_a_gateway_that_does_so():
    fleet = Fleet(replace(SETTINGS, cell_model=replace(SETTINGS.cell_model, free_below=0.05)))
    fleet.integrate(4)
    gathered = fleet.gathered.told(fleet.gather())
    assert encode_pgm(gathered) == encode_pgm(fleet.one.snapshot())
    assert encode_pgm(gathered) != encode_pgm(replace(gathered, model=SETTINGS.cell_model))


def test_names_are_hashes_of_what_the_shares_are_called():
    fleet = Fleet()
    fleet.integrate(3)
    told = fleet.gathered.told(fleet.gather())

    def digest(*lines):
        return hashlib.sha256("".join(f"{line}\n" for line in lines).encode()).hexdigest()[:32]

    assert told.epoch == digest("0 e0", "1 e1", "2 e2", "3 e3")
    assert told.run == digest("0 r0", "1 r1", "2 r2", "3 r3")
    assert told.tag == digest("0 e0-r0-3", "1 e1-r1-3", "2 e2-r2-3", "3 e3-r3-3")
    assert told.revision == 12
    assert told.meta()["tag"] == told.tag


def test_two_gateways_name_equal_maps_equally_and_others_otherwise():
    fleet = Fleet()
    fleet.integrate(3)
    other = GatheredMap(SETTINGS, FOUR, "h")
    for k in (0, 1):
        other.take(k, fleet.shares[k].updates())
    fleet.gather()
    fleet.integrate(1, fleet.shares[:2])
    for k in (2, 3):
        other.take(k, fleet.shares[k].updates())
    first, second = fleet.gathered.told(fleet.gather(0)), other.told(other.state)
    assert (first.epoch, first.run) == (second.epoch, second.run)
    assert first.tag != second.tag  # one scan more of share 0
    fleet.gather()
    for k in range(4):
        part = other.state.parts[k]
        other.take(k, fleet.shares[k].updates(part.revision))
    first, second = fleet.gathered.told(fleet.gathered.state), other.told(other.state)
    assert (first.epoch, first.run, first.revision, first.tag) == (
        *(second.epoch, second.run, second.revision, second.tag),
    )
    assert encode_npz(first) == encode_npz(second)


def test_only_what_a_share_has_changed_is_new_to_who_follows():
    fleet = Fleet()
    fleet.integrate(5)
    before = fleet.gather()
    fleet.integrate(1)
    after = fleet.gather(2)
    changed = ChangedTiles.since(after.copies, before.copies.revision)
    assert 0 < len(changed) < len(ChangedTiles.since(after.copies, 0))
    assert (FOUR.owners(changed.places) == 2).all()
    assert fleet.gather() is not after
    assert fleet.gather() is fleet.gather()  # nothing new


def test_a_share_that_was_started_again_is_taken_whole_and_only_its_differences_are_new():
    fleet = Fleet()
    fleet.integrate(5)
    scan, _ = scan_at(5, fleet.rng)
    last = replace(scan, ranges=np.full(60, 0.5, np.float32)), Pose(5.0, -5.0, 0.0)
    for grid in (fleet.one, *fleet.shares):
        grid.integrate(*last)
    before = fleet.gather()
    # Its store lacks the last scan.
    again = FakeShare(1, epoch="e1", run="later")
    rng = np.random.default_rng(1)
    for k in range(5):
        again.integrate(*scan_at(k, rng))
    fleet.shares[1] = again
    state = fleet.gather(1)
    assert state.life[0] == before.life[0]
    assert state.life[1] != before.life[1]
    changed = ChangedTiles.since(state.copies, before.copies.revision)
    assert changed.places.tolist() == [[1, -2]]  # the one tile that the scan was in
    again.integrate(*last)
    assert encode_npz(fleet.gathered.told(fleet.gather(1))) == encode_npz(fleet.one.snapshot())


def test_tiles_that_a_share_does_not_have_any_more_become_unknown():
    fleet = Fleet()
    fleet.integrate(6)
    before = fleet.gather()
    fleet.shares[3] = FakeShare(3, epoch="e3", run="emptied")
    state = fleet.gather(3)
    assert not _own(fleet, state, 3).any()
    assert _own(fleet, before, 3).any()
    changed = ChangedTiles.since(state.copies, before.copies.revision)
    assert len(changed)  # followers hear of it
    assert (FOUR.owners(changed.places) == 3).all()


def test_a_new_epoch_of_a_share_is_one_of_the_map_and_leaves_nothing_of_the_old_one():
    fleet = Fleet()
    fleet.integrate(6)
    before = fleet.gather()
    fleet.shares[3] = FakeShare(3, epoch="new", run="r3")
    state = fleet.gather(3)
    assert state.life[0] != before.life[0]
    assert state.life[1] == before.life[1]
    assert not _own(fleet, state, 3).any()
    assert state.copies.lineage is not before.copies.lineage


def _own(fleet, state, share):
    """The cells of a share, 20 x 20 m."""
    lattice = Lattice(0.05)
    corner = {0: (-400, -400), 1: (0, -400), 2: (-400, 0), 3: (0, 0)}[share]
    view = fleet.gathered.told(state).stored
    assert lattice == fleet.settings.lattice
    (plane,) = view.window(CellRect(*corner, 400, 400)).values()
    return plane


def test_of_missing_shares_all_is_unknown_and_the_map_has_no_name():
    fleet = Fleet()
    fleet.integrate(6)
    state = fleet.gather()
    missing = [MissingShare(1, FOUR.bounds(1), 77)]
    partial = fleet.gathered.partial(state, missing)
    view = partial.stored
    for share, corner in enumerate(((-400, -400), (0, -400), (-400, 0), (0, 0))):
        shown = view.window(CellRect(*corner, 400, 400))["log_odds"]
        assert shown.any() == (share != 1)
        if share != 1:
            assert np.array_equal(shown, _own(fleet, state, share))
    meta = partial.meta()
    assert meta["missing"] == [{"share": 1, "bounds": [0.0, None, None, 0.0], "since": 77}]
    assert not {"epoch", "run", "revision", "tag"} & meta.keys()


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (GridSettings(resolution=0.1), "resolution is 0.1"),
        (GridSettings(anchor=(0.5, 0.0)), "anchor is"),
        (GridSettings(cell_model=type(SETTINGS.cell_model)("float64")), "cells is"),
        (GridSettings(cell_model=type(SETTINGS.cell_model)(p_prior=0.4)), "cell model is"),
        (GridSettings(cell_model=type(SETTINGS.cell_model)(free_below=0.05)), "'free_below': 0.05"),
    ],
)
def test_parts_of_another_map_are_refused_by_name(settings, named):
    gathered = GatheredMap(SETTINGS, FOUR, "g")
    share = FakeShare(0, settings)
    with pytest.raises(OtherMap, match=named):
        gathered.take(0, share.updates())
    assert gathered.state.parts == (None,) * 4


def test_parts_of_other_cuts_are_refused_by_name():
    gathered = GatheredMap(SETTINGS, FOUR, "g")
    gathered.check_share(2, FakeShare(2).attachment())
    for told, named in (
        (FakeShare(1).attachment(), "share 1"),
        (FakeShare(2, layout=cut((0.0,), (3.2,))).attachment(), r"cuts_y \[3.2\]"),
        ({}, "share None"),
        (FakeShare(2).attachment() | {"settings": "x"}, "settings that cannot be read"),
        (FakeShare(2).attachment() | {"settings": None}, "settings that cannot be read"),
    ):
        with pytest.raises(OtherMap, match=named):
            gathered.check_share(2, told)


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (replace(SETTINGS, reach=6.0), r"made with map\.reach 6\.0, and 5\.0 here"),
        (replace(SETTINGS, half_life=60.0), r"map\.half_life 60\.0, and none here"),
        (replace(SETTINGS, cell_model=LogOdds(p_occ=0.8)), r"map\.p_occ 0\.8, and 0\.7 here"),
        (replace(SETTINGS, cell_model=Rate()), r"map\.cell_model Rate, and LogOdds here"),
    ],
)
def test_parts_whose_cells_become_something_else_of_the_same_scans_are_refused_by_name(settings, named):
    gathered = GatheredMap(SETTINGS, FOUR, "g")
    with pytest.raises(OtherMap, match=named):
        gathered.check_share(2, FakeShare(2, settings).attachment())


def test_cells_of_another_share_and_changes_of_what_is_not_held_are_refused():
    fleet = Fleet()
    fleet.integrate(3)
    with pytest.raises(OtherMap, match="cells of another share"):
        fleet.gathered.take(1, fleet.shares[0].updates())
    with pytest.raises(BadMessage, match="not what is held"):
        fleet.gathered.take(0, fleet.shares[0].updates(2))


def test_a_part_for_which_there_is_no_memory_is_refused_by_name():
    fleet = Fleet()
    fleet.integrate(6)
    gathered = GatheredMap(SETTINGS, FOUR, "g", max_bytes=100_000)
    for share in fleet.shares:
        with contextlib.suppress(LimitReached):
            gathered.take(share.index, share.updates())
    left = min(gathered.state.not_held)
    assert gathered.state.parts[left] == fleet.shares[left].state
    with pytest.raises(LimitReached, match=r"mapper\.max_memory"):
        gathered.take(left, fleet.shares[left].updates())
    assert 0 < gathered.state.copies.nbytes <= 100_000
