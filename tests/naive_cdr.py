"""CDR written number by number, in either byte order: what `ogm_core.ros2.cdr` reads, by no library."""

import struct


class Cdr:
    """Bytes that grow; every number begins at a multiple of its own size, counted after the first four."""

    def __init__(self, order="<"):
        self.order = order
        self.body = b""

    @property
    def bytes(self):
        return (b"\x00\x01\x00\x00" if self.order == "<" else b"\x00\x00\x00\x00") + self.body

    def put(self, letters, *values):
        for letter, value in zip(letters, values, strict=True):
            size = struct.calcsize(letter)
            # What lies between is nobody's: 0xEE, so that who reads it goes wrong.
            self.body += b"\xee" * (-len(self.body) % size) + struct.pack(self.order + letter, value)
        return self

    def text(self, text):
        data = text.encode() + b"\0"
        self.put("I", len(data))
        self.body += data
        return self

    def row(self, letter, values):
        self.put("I", len(values))
        return self.put(letter * len(values), *values)

    def header(self, stamp, frame):
        return self.put("iI", *divmod(stamp, 10**9)).text(frame)


def laser_scan(stamp, frame, numbers, ranges, intensities=(), order="<"):
    """`numbers`: angle_min, angle_max, angle_increment, time_increment, scan_time, range_min, range_max."""
    return (
        Cdr(order).header(stamp, frame).put("fffffff", *numbers).row("f", ranges).row("f", intensities).bytes
    )


def tf_message(transforms, order="<"):
    """`transforms`: (stamp, parent, child, the seven numbers) each."""
    cdr = Cdr(order).put("I", len(transforms))
    for stamp, parent, child, numbers in transforms:
        cdr.put("i", stamp // 10**9).put("I", stamp % 10**9).text(parent).text(child).put("ddddddd", *numbers)
    return cdr.bytes


def pose_stamped(stamp, frame, numbers, order="<"):
    return Cdr(order).header(stamp, frame).put("ddddddd", *numbers).bytes


def pose_with_covariance_stamped(stamp, frame, numbers, order="<"):
    return Cdr(order).header(stamp, frame).put("d" * 43, *numbers, *range(36)).bytes


def odometry(stamp, frame, child, numbers, order="<"):
    cdr = Cdr(order).header(stamp, frame).text(child).put("d" * 43, *numbers, *range(36))
    return cdr.put("d" * 42, *range(42)).bytes


def point_cloud2(stamp, frame, shape, fields, steps, data, *, big_endian=False, order="<"):
    """`shape`: height, width; `fields`: (name, offset, datatype) each; `steps`: of a point and of a row."""
    cdr = Cdr(order).header(stamp, frame).put("II", *shape).put("I", len(fields))
    for name, offset, datatype in fields:
        cdr.text(name).put("IBI", offset, datatype, 1)
    cdr.put("?", big_endian).put("II", *steps).put("I", len(data))
    cdr.body += data
    return cdr.put("?", True).bytes


def occupancy_grid(stamp, frame, resolution, shape, origin, data):
    """`shape`: width, height; `data`: by rows from the lower-left cell."""
    cdr = Cdr().header(stamp, frame).put("iI", *divmod(stamp, 10**9)).put("fII", resolution, *shape)
    return cdr.put("ddddddd", *origin, 0.0, 0.0, 0.0, 0.0, 1.0).row("b", data).bytes


def occupancy_grid_update(stamp, frame, corner, shape, data):
    return Cdr().header(stamp, frame).put("iiII", *corner, *shape).row("b", data).bytes


def ogm_pose(stamp, seq, run, pose):
    return Cdr().put("qq", stamp, seq).text(run).put("ddd", *pose).bytes


def ogm_scan(stamp, seq, run, numbers, mount, pose, ranges):
    """`numbers`: angle_min, angle_increment, time_increment, range_min, range_max; `pose` may be ()."""
    head = Cdr().put("qq", stamp, seq).text(run).put("ddddd", *numbers).put("ddd", *mount)
    return head.row("d", pose).row("f", ranges).bytes
