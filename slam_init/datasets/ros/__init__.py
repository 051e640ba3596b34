"""ROS bags without ROS: ROS 1 (``.bag``) and ROS 2 (sqlite3 and mcap), through the package ``rosbags``.

:mod:`~slam_init.datasets.ros.bag` reads messages, :mod:`~slam_init.datasets.ros.source` chooses topics and makes a
source of them. Images and motions have a module each. Messages of standard types only are read, by the definitions of
``rosbags``: the definitions that a bag holds are ignored, since ``rosbags`` would make code of them.
"""
