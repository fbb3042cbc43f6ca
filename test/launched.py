"""``python launched.py FILE [NAME:=VALUE ...]``: launches a file without the command ros2."""

import sys
from pathlib import Path


def command(path, *arguments):
    """Words of the command that launches the file ``path``."""
    return [sys.executable, str(Path(__file__)), str(path), *arguments]


def main():
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import AnyLaunchDescriptionSource

    from launch import LaunchDescription, LaunchService

    path, *given = sys.argv[1:]
    include = IncludeLaunchDescription(
        AnyLaunchDescriptionSource(path), launch_arguments=[tuple(word.split(":=")) for word in given]
    )
    service = LaunchService()
    service.include_launch_description(LaunchDescription([include]))
    return service.run()


if __name__ == "__main__":
    sys.exit(main())
