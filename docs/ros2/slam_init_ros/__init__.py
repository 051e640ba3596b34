"""The lifecycle node of slam-init for ROS 2."""
