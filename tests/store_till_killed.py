"""`python store_till_killed.py DIR MODEL [HALF_LIFE]`: goes on with the map that is stored there.

There is a commit after every scan. With MODEL robots, those are kept apart, and one is left out now and then.

Prints the fingerprint and the revision of each state before ("trying") and after ("stored") its commit.
"""

import sys
from pathlib import Path

from ogm_core.cells.log_odds import LogOdds
from ogm_core.cells.rate import Rate
from ogm_core.separate_grid import SeparateGrid
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import Story, grid_of

with MapStore(Path(sys.argv[1])) as store:
    model = {"log_odds": LogOdds(), "rate": Rate(), "robots": Rate()}[sys.argv[2]]
    half_life = float(sys.argv[3]) if len(sys.argv) > 3 else None
    grid = grid_of(model, half_life=half_life, separate_robots=sys.argv[2] == "robots")
    before = store.restore(grid.settings)
    story = Story(store, grid) if before is None else Story.going_on(store, before)
    while True:
        story.integrate(1)
        if isinstance(story.grid, SeparateGrid) and story.grid.revision % 4 == 3:
            story.grid.forget(story.grid.robots[0])
        print("trying", story.now, story.grid.revision, flush=True)
        story.commit()
        print("stored", story.now, story.grid.revision, flush=True)
