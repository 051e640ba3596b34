"""The ament_python package of the node: ``colcon build`` calls this file."""

from setuptools import setup

NAME = "slam_init_ros"

setup(
    name=NAME,
    version="1.0.0",
    packages=[NAME],
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
    ],
    install_requires=["setuptools", "slam-init"],
    license="MIT",
    entry_points={"console_scripts": [f"initializer = {NAME}.node:main"]},
)
