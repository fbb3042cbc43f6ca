# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
from glob import glob

from setuptools import find_packages, setup

NAME = "valve_control"
NODES = [
    "controller",
    "valve_simulator",
    "valve_driver",
    "command_source",
    "manifold",
    "recorder",
    "axis_simulator",
    "axis_controller",
    "dashboard",
]

setup(
    name=NAME,
    version="1.0.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", glob("config/*.*")),
        (f"share/{NAME}/config/demo", glob("config/demo/*")),
        (f"share/{NAME}/config/tuned", glob("config/tuned/*")),
        (f"share/{NAME}/config/commands", glob("config/commands/*")),
        (f"share/{NAME}/config/axis", glob("config/axis/*.yaml")),
        (f"share/{NAME}/config/solenoid", glob("config/solenoid/*.yaml")),
        (f"share/{NAME}/launch", glob("launch/*.launch.xml")),
    ],
    package_data={NAME: ["py.typed", "nodes/*.xml", "export/*.[ch]", "dashboard/*.js", "dashboard/*.css"]},
    install_requires=[
        "setuptools",
        "numpy>=1.26",
        "scipy>=1.11",
        "numba>=0.58",
        "matplotlib>=3.6",
        "PyYAML>=6",
        "tqdm>=4.60",
        "rosbags>=0.10",
        "mcap>=1.6",
        "lz4>=4.3",
        "zstandard>=0.22",
        "plotly>=6.0",
        "cma>=4.0",
    ],
    extras_require={
        "axis": ["ruckig>=0.14"],
        "canopen": ["canopen>=2.4", "python-can>=4.6", "pyserial>=3.5"],
        "dashboard": ["nicegui>=3.18,<4"],
        "logs": ["mat-io>=1.0", "asammdf>=8.8"],
        "modbus": ["pymodbus>=3.16,<4"],
        "serial": ["pyserial>=3.5"],
        "test": [
            "pytest>=7.4",
            "pytest-rerunfailures>=12.0",
            "hypothesis>=6.90",
            "sympy>=1.12",
            "pyserial>=3.5",
            "fmpy>=0.3.20",
            "ruckig>=0.14",
            "nicegui>=3.18,<4",
            "selenium>=4.30",
            "psutil>=5.9",
            "pymodbus>=3.16,<4",
            "canopen>=2.4",
            "python-can>=4.6",
            "mat-io>=1.0",
            "asammdf>=8.8",
        ],
    },
    python_requires=">=3.11",
    zip_safe=True,
    maintainer="valve_control developers",
    maintainer_email="maintainers@valve-control.example.com",
    description="Local control of a proportional directional control valve.",
    license="Apache-2.0",
    entry_points={
        "console_scripts": [
            "valve-control = valve_control.cli:main",
            *(f"{node} = {NAME}.nodes.{node}:main" for node in NODES),
        ]
    },
)
