"""The ament package of imgloc: its executables are those of the Python package imgloc."""

from pathlib import Path

from setuptools import setup

NAME = "imgloc_ros"
SHARED = ("launch/*.launch.py", "config/*.yaml", "rviz/*.rviz", "foxglove/*.json")

setup(
    name=NAME,
    version="0.1.0",
    description="imgloc for ROS 2",
    license="MIT",
    packages=[],
    zip_safe=True,
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *((f"share/{NAME}/{one.split('/')[0]}", sorted(map(str, Path().glob(one))))
          for one in SHARED),
    ],
    entry_points={"console_scripts": ["imgloc = imgloc.__main__:main"]},
)  # fmt: skip
