"""Bags of one damper under other names, types and units, for the proposals of signals files."""

from __future__ import annotations

import numpy as np
import tiny_bags as tiny

SAMPLES, PERIOD_NS = 1500, 2_000_000
CUSTOM = "lab_msgs/msg/Float64Stamped"
ARRAY, SCALAR = "std_msgs/msg/Float32MultiArray", "std_msgs/msg/Float64"


def motion(seed=0.0, samples=SAMPLES):
    """Time [s], position [m], current [A] and force [N] of a damper whose rebound is harder than its compression."""
    t = np.arange(samples) * PERIOD_NS * 1e-9
    x = 0.012 * np.sin(2 * np.pi * 2.3 * t + seed) + 0.004 * np.sin(2 * np.pi * 6.1 * t + 2 * seed)
    v = np.gradient(x, t)
    i = 0.3 + 0.4 * (np.floor(t + 0.3 * seed) % 2)
    force = np.sign(v) * np.sqrt(np.abs(v)) * (200.0 + 900.0 * i) * np.where(v < 0, 2.0, 1.0)
    return t, x, i, force


def custom_store():
    """The Jazzy types, and a stamped number that is defined in the bag only."""
    store = tiny.get_typestore(tiny.Stores.ROS2_JAZZY)
    store.register(tiny.get_types_from_msg("std_msgs/Header header\nfloat64 value\n", CUSTOM))
    return store


def stamps(samples=SAMPLES):
    return [5 * tiny.SECOND + k * PERIOD_NS for k in range(samples)]


def stream(topic, kind, make, *columns):
    """One topic whose messages `make(stamp_ns, *values)` builds from the columns."""
    rows = zip(stamps(len(columns[0])), *(np.asarray(c).tolist() for c in columns), strict=True)
    return topic, kind, [(row[0], make(*row)) for row in rows]


def numbers(topic, values):
    return stream(topic, SCALAR, lambda _, v: tiny.number(v), values)


def wrenches(topic, values):
    return stream(topic, tiny.WRENCH, tiny.wrench, values)


def joints(topic, names, *columns, efforts=()):
    columns = (*columns, *efforts)
    count = len(names)
    return stream(topic, tiny.JOINTS, lambda t, *v: tiny.joints(t, names, v[:count], efforts=v[count:]), *columns)


def stamped(topic, values, store):
    message = store.types[CUSTOM]
    return stream(topic, CUSTOM, lambda t, v: message(header=tiny.header(t), value=v), values)


def array(topic, *columns):
    def make(_, *values):
        layout = tiny.TYPES["std_msgs/msg/MultiArrayLayout"](dim=[], data_offset=0)
        return tiny.TYPES[ARRAY](layout=layout, data=np.array(values, dtype=np.float32))

    return stream(topic, ARRAY, make, *columns)
