# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Columns of serialized messages against the rosbags library, which decodes them one by one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from valve_control.recordings.bags.cdr import Decoder, normal, places
from valve_control.recordings.bags.errors import BagError
from valve_control.recordings.bags.messages import Topic

TYPES = get_typestore(Stores.ROS2_JAZZY)
T = TYPES.types
numbers = st.floats(allow_nan=False, width=64)
words = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)


def joint_state(draw):
    count = draw(st.integers(0, 4))
    values = [np.array(draw(st.lists(numbers, min_size=count, max_size=count))) for _ in range(3)]
    stamp = T["builtin_interfaces/msg/Time"](draw(st.integers(0, 2**31 - 1)), draw(st.integers(0, 10**9 - 1)))
    header = T["std_msgs/msg/Header"](stamp, draw(words))
    names = [draw(words) for _ in range(count)]
    return T["sensor_msgs/msg/JointState"](header, names, *values)


def multi_array(draw):
    labels = draw(st.lists(words, max_size=4))
    dim = [T["std_msgs/msg/MultiArrayDimension"](label, 1, 1) for label in labels]
    layout = T["std_msgs/msg/MultiArrayLayout"](dim, draw(st.integers(0, 9)))
    return T["std_msgs/msg/Float64MultiArray"](layout, np.array(draw(st.lists(numbers, max_size=5))))


def imu(draw):
    vector = T["geometry_msgs/msg/Vector3"]
    stamp = T["builtin_interfaces/msg/Time"](1, 2)
    header = T["std_msgs/msg/Header"](stamp, draw(words))
    nine = np.array(draw(st.lists(numbers, min_size=9, max_size=9)))
    return T["sensor_msgs/msg/Imu"](
        header, T["geometry_msgs/msg/Quaternion"](*(draw(numbers) for _ in range(4))), nine,
        vector(*(draw(numbers) for _ in range(3))), nine, vector(1.0, 2.0, 3.0), nine,
    )  # fmt: skip


def packed(messages, little_endian=True):
    raw = [bytes(TYPES.serialize_cdr(m, m.__msgtype__, little_endian=little_endian)) for m in messages]
    length = np.array([len(r) for r in raw], dtype=np.int64)
    buffer = np.frombuffer(b"".join(raw), dtype=np.uint8)
    return raw, buffer, np.cumsum(length) - length, length


def fields_of(message):
    """Every number in a message."""
    return [
        path if leaf.entries is None else f"{path}[{k}]"
        for path, leaf in message.leaves.items()
        for k in range(1 if leaf.entries is None else leaf.entries)
    ]


@pytest.mark.parametrize("make", [joint_state, multi_array, imu])
@settings(max_examples=40, deadline=None)
@given(data=st.data(), little_endian=st.booleans())
def test_columns_are_what_the_library_decodes(make, data, little_endian):
    """Messages of many layouts mixed, every number of each."""
    messages = [make(data.draw) for _ in range(data.draw(st.integers(1, 6)))]
    raw, buffer, offset, length = packed(messages, little_endian)
    topic = Topic("/t", messages[0].__msgtype__)
    for i, message in enumerate(messages):
        for field in fields_of(places(topic, raw[i])):
            values, done = Decoder(topic, field).decode(buffer, offset, length)
            assert done[i] and values[i] == eval(f"m.{field}", {"m": message}), field
            assert np.array_equal(np.isnan(values), ~done)


def test_labels_choose_entries_wherever_they_stand():
    def state(labels, values):
        dim = [T["std_msgs/msg/MultiArrayDimension"](label, 1, 1) for label in labels]
        layout = T["std_msgs/msg/MultiArrayLayout"](dim, 0)
        return T["std_msgs/msg/Float64MultiArray"](layout, np.array(values))

    messages = [
        state(["a", "b", "c"], [1.0, 2.0, 3.0]), state(["c", "a", "b"], [4.0, 5.0, 6.0]), state(["b"], [7.0])
    ]  # fmt: skip
    raw, buffer, offset, length = packed(messages)
    topic = Topic("/t", "std_msgs/msg/Float64MultiArray")
    values, done = Decoder(topic, "data[b]").decode(buffer, offset, length)
    assert values.tolist() == [2.0, 6.0, 7.0] and done.all()
    values, done = Decoder(topic, "data[a]").decode(buffer, offset, length)
    assert np.array_equal(values, [1.0, 5.0, np.nan], equal_nan=True) and done.tolist() == [True, True, False]
    assert places(topic, raw[1]).labels("data") == ["c", "a", "b"]


@pytest.mark.parametrize("cut", [0, 3, 4, 8, 20, 50])
def test_short_messages_are_counted_not_guessed(cut):
    raw, *_ = packed([imu(lambda s: 1.0 if s is numbers else "w" if s is words else [1.0] * 9)])
    topic = Topic("/imu", "sensor_msgs/msg/Imu")
    broken = np.frombuffer(raw[0][:cut] + raw[0], dtype=np.uint8)
    decoder = Decoder(topic, "orientation.w")
    values, done = decoder.decode(broken, np.array([0, cut]), np.array([cut, len(raw[0])]))
    assert done.tolist() == [False, True] and values[1] == 1.0 and decoder.error


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("position", ["list", "position[0]"]),
        ("position[7]", ["position", "2 entries"]),
        ("position[knee]", ["knee", "boom, arm"]),
        ("speed", ["speed", "position[0]"]),
        ("header.stamp.sec[0]", ["single number"]),
    ],
)
def test_a_wrong_field_is_told_what_there_is(field, words):
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
    message = T["sensor_msgs/msg/JointState"](
        header, ["boom", "arm"], np.array([0.5, 0.25]), np.array([]), np.array([])
    )
    decoder = Decoder(Topic("/j", "sensor_msgs/msg/JointState"), field)
    assert not decoder.decode(*packed([message])[1:])[1].any()
    for word in words:
        assert word in decoder.reason


@pytest.mark.parametrize("field", ["", "a b", "a[", "[0]x y", "a..b", "1a"])
def test_what_is_no_field_is_refused(field):
    with pytest.raises(BagError):
        normal(field)


def test_the_bag_s_own_definition_wins():
    topic = Topic("/t", "my/msg/Own", definition_format="ros2msg", definition="uint8 a\nfloat64 b")
    raw = b"\0\1\0\0" + b"\7" + b"\0" * 7 + np.float64(2.5).tobytes()
    buffer = np.frombuffer(raw, dtype=np.uint8)
    for field, value in (("a", 7.0), ("b", 2.5)):
        values, done = Decoder(topic, field).decode(buffer, np.array([0]), np.array([len(raw)]))
        assert values.tolist() == [value] and done.all()
