"""Messages and recordings of ROS, made by rosbags itself; a test that imports this is skipped without the package."""

import numpy as np
import pytest

rosbag1 = pytest.importorskip("rosbags.rosbag1", reason="rosbags is not installed (the extra ros)")
rosbag2 = pytest.importorskip("rosbags.rosbag2")
interfaces = pytest.importorskip("rosbags.interfaces")
typesys = pytest.importorskip("rosbags.typesys")

ROS1 = typesys.get_typestore(typesys.Stores.ROS1_NOETIC)
ROS1.register(typesys.get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
ROS2 = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)


def make(store, kind, **told):
    """A message: `pose__position__x=1.0` is a field of a field; fields not told are 0, empty or made alike."""
    fields = {}
    for name, (node, of) in store.fielddefs[kind][1]:
        within = {key.removeprefix(f"{name}__"): told[key] for key in told if key.startswith(f"{name}__")}
        if name in told:
            fields[name] = told[name]
        elif node == interfaces.Nodetype.NAME:
            fields[name] = make(store, of, **within)
        elif node == interfaces.Nodetype.BASE:
            fields[name] = "" if of[0] == "string" else 0
        else:
            fields[name] = np.zeros(of[1], of[0][1][0])
    return store.types[kind](**fields)


def write(path, topics):
    """A recording of lists of messages, one a second and topic; the path of the file that was written.

    A suffix of .bag is a recording of ROS 1; of .mcap and .db3 one of ROS 2, in a folder of that name.
    """
    if path.suffix == ".bag":
        store, writer, file = ROS1, rosbag1.Writer(path), path
    else:
        plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else rosbag2.StoragePlugin.SQLITE3
        store, file = ROS2, path.with_suffix("") / path.name
        writer = rosbag2.Writer(file.parent, version=9, storage_plugin=plugin)
    with writer:
        for topic, (kind, messages) in topics.items():
            connection = writer.add_connection(topic, kind, typestore=store)
            for second, one in enumerate(messages):
                told = store.serialize_ros1(one, kind) if store is ROS1 else store.serialize_cdr(one, kind)
                writer.write(connection, second * 10**9, told)
    return file
