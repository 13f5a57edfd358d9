"""`python store_on_failing_disk.py DIR KIND ERROR`: stores a map on a disk that fails (failing_disk.c).

Prints a line for each fault that was told to come: after how many calls that went well, whether it came, what
the store said, and whether what a crash leaves right after it, and right after the next commit, is exact.
"""

import json
import os
import shutil
import sys
from pathlib import Path

from ogm_core.errors import OgmError
from ogm_services.mapper.storage import map_store
from ogm_services.mapper.storage.map_store import MapStore
from stored_maps import Story, grid_of, restored


def main(folder, kind, error):
    control = Path(os.environ["FAILING_DISK"])
    map_store.WAL_BYTES = 30_000  # the log's pages go into the file every few commits
    with MapStore(folder / "map") as store:
        story = Story(store, grid_of())
        story.integrate(3)
        story.commit()
        tried = set()  # what failed may be on disk all the same: then it is there as a whole
        for well in [*range(16), 20, 30, 40]:
            said = []
            for _ in range(2):  # a failure, and one more on top of it
                story.integrate(2)
                tried.add(story.now)
                control.write_text(f"{kind} {error} {well}")
                try:
                    story.commit()
                except OgmError as failure:
                    said.append(f"{type(failure).__name__}: {failure}")
                control.write_text("")
                after_fault = left_by_a_crash(folder, story) in {*story.states, *tried}
            story.integrate(1)
            story.commit()
            after_next = left_by_a_crash(folder, story) == story.now
            line = {"well": well, "said": said, "after_fault": after_fault, "after_next": after_next}
            print(json.dumps(line), flush=True)
        os._exit(0)  # as a crash: nothing is closed


def left_by_a_crash(folder, story):
    """The state that a store of this moment's files holds."""
    copy = folder / "copy"
    shutil.copytree(folder / "map", copy)
    with MapStore(copy) as store:
        state = restored(store, story.grid.settings)
    shutil.rmtree(copy)
    return state


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]))
