# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Columns of serialized messages against the rosbags library, which decodes them one by one."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from valve_control.recordings.bags.cdr import Decoder
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


def vector(draw):
    twist, three = T["geometry_msgs/msg/Twist"], T["geometry_msgs/msg/Vector3"]
    return twist(*(three(*(draw(numbers) for _ in range(3))) for _ in range(2)))


def fields_of(message, path=""):
    """Every number in a message."""
    for field in dataclasses.fields(message):
        value, place = getattr(message, field.name), f"{path}.{field.name}".lstrip(".")
        if dataclasses.is_dataclass(value):
            yield from fields_of(value, place)
        elif isinstance(value, np.ndarray):
            yield from (f"{place}[{k}]" for k in range(len(value)))
        elif isinstance(value, (int, float, np.number)):
            yield place


@pytest.mark.parametrize("make", [joint_state, multi_array, imu, vector])
@settings(max_examples=40, deadline=None)
@given(data=st.data(), little_endian=st.booleans())
def test_columns_are_what_the_library_decodes(make, data, little_endian):
    """Messages of many layouts mixed, every number of each."""
    messages = [make(data.draw) for _ in range(data.draw(st.integers(1, 6)))]
    _, *packed_messages = packed(messages, little_endian)
    fields = sorted({field for message in messages for field in fields_of(message)})
    values, present = Decoder(Topic("/t", messages[0].__msgtype__), fields).decode(*packed_messages)
    assert np.array_equal(np.isnan(values), ~present)
    for message, row, mask in zip(messages, values, present, strict=True):
        assert [f for f, there in zip(fields, mask, strict=True) if there] == sorted(fields_of(message))
        for field in fields_of(message):
            assert row[fields.index(field)] == eval(f"m.{field}", {"m": message}), field


def test_labels_choose_entries_wherever_they_stand():
    def state(names, values):
        dim = [T["std_msgs/msg/MultiArrayDimension"](label, 1, 1) for label in names]
        layout = T["std_msgs/msg/MultiArrayLayout"](dim, 0)
        return T["std_msgs/msg/Float64MultiArray"](layout, np.array(values))

    messages = [
        state(["a", "b", "c"], [1.0, 2.0, 3.0]), state(["c", "a", "b"], [4.0, 5.0, 6.0]), state(["b"], [7.0])
    ]  # fmt: skip
    decoder = Decoder(Topic("/t", "std_msgs/msg/Float64MultiArray"), ["data[a]", "data[b]"])
    values, present = decoder.decode(*packed(messages)[1:])
    assert np.array_equal(values, [[1.0, 2.0], [5.0, 6.0], [np.nan, 7.0]], equal_nan=True)
    assert np.array_equal(np.isnan(values), ~present) and decoder.absent == {"data[a]": 1}


@pytest.mark.parametrize("cut", [0, 3, 4, 8, 20, 50])
def test_short_messages_are_counted_not_guessed(cut):
    for make, field in ((imu, "orientation.w"), (vector, "linear.y")):
        message = make(lambda s: 1.0 if s is numbers else "w" if s is words else [1.0] * 9)
        raw = packed([message])[0][0]
        decoder = Decoder(Topic("/t", message.__msgtype__), [field])
        values, present = decoder.decode(
            np.frombuffer(raw[:cut] + raw, dtype=np.uint8), np.array([0, cut]), np.array([cut, len(raw)])
        )
        assert present[:, 0].tolist() == [False, True] and values[1, 0] == 1.0
        assert decoder.undecodable == 1 and decoder.error


@pytest.mark.parametrize(
    ("field", "words"),
    [
        ("position", ["list", "position[0]"]),
        ("position[7]", ["position", "2 entries"]),
        ("position[knee]", ["knee", "boom, arm"]),
        ("speed", ["speed", "position[0]"]),
        ("header.stamp.sec[0]", ["no list"]),
    ],
)
def test_a_wrong_field_is_told_what_there_is(field, words):
    header = T["std_msgs/msg/Header"](T["builtin_interfaces/msg/Time"](0, 0), "")
    message = T["sensor_msgs/msg/JointState"](
        header, ["boom", "arm"], np.array([0.5, 0.25]), np.array([]), np.array([])
    )
    decoder = Decoder(Topic("/j", "sensor_msgs/msg/JointState"), [field])
    assert not decoder.decode(*packed([message])[1:])[1].any()
    for word in words:
        assert word in decoder.reason


@pytest.mark.parametrize("field", ["", "a b", "a[", "[0]x y", "a..b", "1a"])
def test_what_is_no_field_is_refused(field):
    with pytest.raises(BagError):
        Decoder(Topic("/t", "std_msgs/msg/Float64"), [field])


def test_the_bag_s_own_definition_wins():
    topic = Topic("/t", "my/msg/Own", definition_format="ros2msg", definition="uint8 a\nfloat64 b")
    raw = b"\0\1\0\0" + b"\7" + b"\0" * 7 + np.float64(2.5).tobytes()
    buffer = np.frombuffer(raw, dtype=np.uint8)
    values, done = Decoder(topic, ["a", "b"]).decode(buffer, np.array([0]), np.array([len(raw)]))
    assert values.tolist() == [[7.0, 2.5]] and done.all()
