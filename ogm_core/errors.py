"""Exceptions: everything that this project raises on purpose.

OgmError
+-- BadInput              something given to us is wrong: the text says what, and what to do
|   +-- BadMessage        a payload is not a Pose or Scan
|   +-- BadCdr            a ROS 2 payload is not the message that its topic carries
|   +-- BadParameter      a request's parameter is unknown, ill-formed or out of range
|   +-- BadSetting        a map setting contradicts itself or is out of range
|   +-- BadRecording      a log cannot be read, or holds no scan
|   +-- BadWorld          a simulated world's description is wrong
|   +-- BadMapFile        a map file (YAML and picture, or NPZ) cannot be read, or is not one
|   +-- BadStore          a map's store on disk is damaged, or of another version
|   +-- MissingExtra      what is asked for needs a package that is not installed
+-- ScanRefused           a well-formed scan is not integrated
|   +-- NoPose            its robot's poses do not tell where it was taken
|   |   +-- NoTransform   the transforms between ROS 2 frames do not tell it
|   |       +-- NoTransformYet   and those to come may
|   +-- NoCommonFrame     its robot's poses are in a frame that has no place in the map
|   +-- Tilted            its sensor does not look along the floor
|   +-- Stale             it lies before the robot's oldest kept pose
|   +-- LimitReached      it would stretch the map past its limits; so would a map to start with
|   +-- OutsideBounds     every beam leaves bounds that drop such beams
+-- DiskFull              there is no room for a file that is to be written
+-- MapEmpty              there is no known cell to draw
+-- UnknownRobot          a robot that is to be left out of a map is not in it
"""

MAX_SHOWN = 100
"""So much of a text that was given is repeated in an error, characters."""
SMALLER_MAP = "map with larger cells (resolution), or keep far ends out (reach, bounds)"
"""What helps, whichever of its limits a map reaches."""


def cut(text: str) -> str:
    """A text that was given, cut to what an error repeats of it."""
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}..."


def printable(text: str) -> str:
    """A text with a question mark for every character that ends a line, or that a terminal does not show."""
    return "".join(letter if letter.isprintable() else "?" for letter in text)


class OgmError(Exception):
    """Base of every error that is raised on purpose; anything else is a bug."""

    slug = "error"
    """Stable name of the kind of error: the `type` of problem+json and of Zenoh error replies."""


class BadInput(OgmError):
    """Something that was given to us is wrong; the text says what, and what to do."""

    slug = "bad-input"


class BadMessage(BadInput):
    """A payload is not a well-formed Pose or Scan."""

    slug = "bad-message"


class BadCdr(BadInput):
    """A ROS 2 payload is damaged, or not of the type that its topic carries."""

    slug = "bad-cdr"


class BadParameter(BadInput):
    """A request's parameter is unknown, ill-formed or out of range."""

    slug = "bad-parameter"


class BadSetting(BadInput):
    """A map setting contradicts itself or is out of range."""

    slug = "bad-setting"


class BadRecording(BadInput):
    """A recorded log cannot be read, or holds no scan."""

    slug = "bad-recording"


class BadWorld(BadInput):
    """The description of a simulated world is wrong."""

    slug = "bad-world"


class BadMapFile(BadInput):
    """A map file, or the picture that it names, cannot be read or is not what is needed."""

    slug = "bad-map-file"


class BadStore(BadInput):
    """A map's store on disk is damaged, of another version, or no store at all."""

    slug = "bad-store"


class MissingExtra(BadInput):
    """What is asked for needs a package that is not installed, as only some need it; the text says which."""

    slug = "missing-extra"


_OF_MEMORY = frozenset({"limit", "max_bytes", "max_memory", "memory"})


class ScanRefused(OgmError):
    """A well-formed scan is not integrated; the slug is the reason that it is counted under."""

    slug = "refused"

    def __init__(self, text: str, kind: str | None = None) -> None:
        """`kind`: in which of its ways it is refused; refusals of one kind are told together."""
        super().__init__(text)
        self.kind = kind or self.slug

    @property
    def by_memory(self) -> bool:
        """Whether it is for want of memory alone: another map with the same limits of scans may take it."""
        return self.kind in _OF_MEMORY


class NoPose(ScanRefused):
    """The poses of a scan's robot do not tell where it was taken."""

    slug = "no_pose"


class NoTransform(NoPose):
    """Nothing is known of a transform between two frames of ROS 2; the text names both."""


class NoTransformYet(NoTransform):
    """Nothing is known of it so far: what comes later may tell."""


class NoCommonFrame(ScanRefused):
    """A scan's robot has poses in a frame of its own, of which nobody says where in the map it lies."""

    slug = "no_common_frame"


class Tilted(ScanRefused):
    """A scan's sensor does not look along the floor, so that its beams are no lines of a floor plan."""

    slug = "tilted"


class Stale(ScanRefused):
    """A scan's stamp lies before the oldest kept pose of its robot."""

    slug = "stale"


class LimitReached(ScanRefused):
    """A scan would stretch the map past a limit, or what can be addressed; the kind is the limit's name."""

    slug = "limit"


class NoRoom(LimitReached):
    """A scan needs more new tiles than the map may hold bytes."""


class OutsideBounds(ScanRefused):
    """Every beam that counts starts or ends outside the bounds of a map that drops such beams."""

    slug = "outside"


class DiskFull(OgmError):
    """There is no room for a file that is to be written; what was there before is still there."""

    slug = "disk-full"


class MapEmpty(OgmError):
    """The map has no known cell yet, so there is nothing to draw."""

    slug = "map-empty"


class UnknownRobot(OgmError):
    """A robot that is to be left out of a map is not in it."""

    slug = "unknown-robot"
