"""The slow, obvious twin of the scan placer, for one robot: whole lists, looked through from end to end.

Messages are tuples ("pose", run, seq, stamp, (x, y, theta)), ("scan", run, seq, stamp, sensor, stamps of all
beams) or ("gone" or "here", run), stamps in ns.
"""

import math

MS = 1_000_000


def turn(start, end):
    return math.remainder(end - start, math.tau)


def near(p, q):
    return math.hypot(q[0] - p[0], q[1] - p[1]) <= 0.01 and abs(turn(p[2], q[2])) <= math.radians(0.5)


class Placing:
    def __init__(self, gap=0.5, wait=2.0, speed=20.0, rate=10.0):
        self.gap, self.wait_ns, self.speed, self.rate = gap, wait * 1e9, speed, rate
        self.owner, self.replaced, self.gone = None, [], set()
        self.last_seq, self.streak = None, []
        self.poses, self.ambiguous, self.provisional = [], set(), None  # (stamp, pose)
        self.histories = 0
        self.sources, self.waiting = {}, []
        self.placed, self.dropped, self.notes = [], {}, {}
        self.number = -1

    def play(self, messages):
        for message in messages:
            self.number += 1
            {"pose": self.pose, "scan": self.scan, "gone": self.token, "here": self.token}[message[0]](
                *message
            )
        for item in self.waiting:
            self.dropped[item["number"]] = "no_pose"
        return self

    def token(self, kind, run):
        self.gone = self.gone - {run} if kind == "here" else self.gone | {run}

    def reaches(self, a, b):
        dt = abs(b[0] - a[0]) / 1e9
        far = math.hypot(b[1][0] - a[1][0], b[1][1] - a[1][1])
        return far <= self.speed * dt + 0.05 and abs(turn(a[1][2], b[1][2])) <= self.rate * dt + 0.1

    def begin(self, entries, keep):
        """A new history of poses: what waits is dropped, but for what `keep` says."""
        for item in [item for item in self.waiting if not keep(item)]:
            self.dropped[item["number"]] = "no_pose"
            self.waiting.remove(item)
        self.poses, self.provisional, self.streak = list(entries), None, []
        self.ambiguous = {stamp for stamp in self.ambiguous if stamp in [entry[0] for entry in entries]}
        self.histories += 1
        for source in self.sources.values():
            source["step"] = None

    def came_after_a_step(self, item):
        step = self.sources[item["sensor"]]["step"]
        return step is not None and item["number"] >= step

    def note(self, what):
        self.notes[what] = self.notes.get(what, 0) + 1

    def pose(self, _, run, seq, stamp, pose):
        entry = (stamp, pose)
        if run in self.replaced and self.owner not in self.gone:
            self.replaced.remove(run)
            self.replaced.append(run)
            self.note("superseded")
            return
        if run != self.owner:
            if run in self.replaced:
                self.replaced.remove(run)
            if self.owner is not None:
                self.replaced = [*self.replaced, self.owner][-8:]
            self.owner, self.last_seq, self.ambiguous = run, seq, set()
            self.begin([entry], lambda item: item["run"] == run)
            self.look()
            return
        newest = self.provisional or self.poses[-1]
        anew = any(source["step"] is not None for source in self.sources.values())
        if stamp < newest[0]:
            above = run == "" or seq > self.last_seq or seq == self.last_seq == 0
            if newest[0] - stamp <= 50 * MS or not above:
                self.streak = [s for s in self.streak if self.streak[-1] < stamp] + [stamp]
                if len(self.streak) < 5:
                    self.note("late")
                    return
            self.note("restarted")
            self.ambiguous = set()
            self.begin([entry], self.came_after_a_step)
        elif stamp == newest[0]:
            if near(newest[1], pose):
                self.note("late")
                return
            if anew:
                self.ambiguous = set()
                self.begin([entry], self.came_after_a_step)
            else:
                self.note("ambiguous")
                self.ambiguous.add(stamp)
        elif anew:
            self.begin([entry], self.came_after_a_step)
        elif self.provisional is None:
            self.streak = []
            if self.reaches(newest, entry):
                self.poses.append(entry)
            else:
                self.provisional = entry
        else:
            self.streak = []
            odd, before = self.reaches(self.provisional, entry), self.reaches(self.poses[-1], entry)
            if odd and before:
                self.begin([entry], self.came_after_a_step)
            elif odd:
                self.begin([self.provisional, entry], self.came_after_a_step)
            else:
                self.note("outlier")
                if before:
                    self.poses.append(entry)
                    self.provisional = None
                else:
                    self.provisional = entry
        self.last_seq = seq
        while len(self.poses) > 1024 and self.poses[-1][0] - self.poses[0][0] > 60_000 * MS:
            self.poses.pop(0)
        self.look()

    def scan(self, _, run, seq, stamp, sensor, beams):
        source = self.sources.setdefault(
            sensor, {"run": None, "replaced": [], "seen": [], "newest": [], "step": None, "holds": False}
        )
        item = {"number": self.number, "sensor": sensor, "run": run, "stamp": stamp, "beams": beams}
        if run != "" and (run, seq) in source["seen"]:
            self.dropped[self.number] = "duplicate"
            return
        first_of_all, seqs = not source["seen"], [s for r, s in source["seen"] if r == run]
        source["seen"].append((run, seq))
        if run in self.replaced or (run in source["replaced"] and source["run"] not in self.gone):
            self.dropped[self.number] = "superseded"
            return
        if source["run"] is not None and run != source["run"]:
            kept = [r for r in source["replaced"] if r not in (run, source["run"])]
            source["replaced"] = [*kept, source["run"]][-8:]
        source["run"] = run
        if not seqs and not first_of_all:
            source["holds"] = True
        above = run == "" or not seqs or seq > max(seqs) or seq == max(seqs) == 0
        before = [s for history, s in source["newest"] if history == self.histories]
        # "no new history begun since that newest one came"
        if before and source["newest"][-1][0] == self.histories and above and stamp < max(before) - 50 * MS:
            for other in [other for other in self.waiting if other["sensor"] == sensor]:
                self.dropped[other["number"]] = "no_pose"
                self.waiting.remove(other)
            source["holds"], source["step"], source["newest"] = True, self.number, []
        source["newest"].append((self.histories, stamp))
        if source["holds"]:
            self.waiting.append(item)
        else:
            self.look_at(item)
        mine = [other for other in self.waiting if other["sensor"] == sensor]
        for other in mine:
            if max(one["stamp"] for one in mine) - other["stamp"] > 60_000 * MS:
                self.dropped[other["number"]] = "no_pose"
                self.waiting.remove(other)

    def look(self):
        for source in self.sources.values():
            source["holds"] = False
        items, self.waiting = self.waiting, []
        for item in items:
            self.look_at(item)

    def look_at(self, item):
        stamps = [entry[0] for entry in self.poses]
        if not stamps:
            self.waiting.append(item)
        elif item["stamp"] > (self.provisional or self.poses[-1])[0] + self.wait_ns:
            self.dropped[item["number"]] = "no_pose"
        elif item["stamp"] < stamps[0]:
            self.dropped[item["number"]] = "stale"
        elif max(item["beams"]) > stamps[-1]:
            self.waiting.append(item)
        else:
            poses = [self.pose_at(beam) for beam in item["beams"]]
            if None in poses:
                self.dropped[item["number"]] = "no_pose"
            else:
                self.placed.append((item["number"], poses[0]))

    def pose_at(self, stamp):
        for entry in self.poses:
            if entry[0] == stamp:
                return None if stamp in self.ambiguous else entry[1]
        earlier, later = [e for e in self.poses if e[0] < stamp], [e for e in self.poses if e[0] > stamp]
        if not earlier or not later:
            return None
        a, b = earlier[-1], later[0]
        if a[0] in self.ambiguous or b[0] in self.ambiguous or not self.reaches(a, b):
            return None
        if (b[0] - a[0]) / 1e9 > self.gap and not near(a[1], b[1]):
            return None
        f = (stamp - a[0]) / (b[0] - a[0])
        return (
            *(p + f * (q - p) for p, q in zip(a[1][:2], b[1][:2], strict=True)),
            a[1][2] + f * turn(a[1][2], b[1][2]),
        )
