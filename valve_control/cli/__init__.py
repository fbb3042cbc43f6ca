"""The `valve-control` command."""

import argparse
import contextlib
import os
import sys
from collections.abc import Sequence

from valve_control import __version__
from valve_control.bags.errors import BagError
from valve_control.cli import calibration, identification, paper, recordings, simulate, study, theorems
from valve_control.cli.common import Parser
from valve_control.parameters.table import ParameterError

EXAMPLES = """examples:
  valve-control simulate --controller arc --figure arc.png
  valve-control simulate --controller oarc --scenario sine --set frequency=6.0 --set amplitude=1.0
  valve-control simulate --controller arc --params-file config/arc.yaml --json -
  valve-control compare --params-file config/d3fxe.yaml --figure compare.png
  valve-control analyze my_bag --html report.html --expect 'e_rms<0.02'
  valve-control analyze my_bag --map spool_position=/joint_states.position[0]*250
  valve-control replay my_bag --mode shadow --controller oarc
  valve-control replay my_bag --mode what-if --set arc.k1=150
  valve-control compare monday_bag tuesday_bag --html both.html
  valve-control bag recover my_bag
  valve-control calibrate paper --set duration=9.3 --output my_valve.yaml
  valve-control paper
  valve-control identify --set lvdt.noise=0.005 --output valve.yaml --figure bode.png
  valve-control compensator --from valve.yaml --bandwidth 25 --output compensator.yaml
  valve-control theorems --figure theorems.png
  valve-control study --controller oarc --valves 10000 --figure study.png
  valve-control study --controller oarc --replay 4711 --figure worst.png
  valve-control parameters arc
"""


def parser() -> argparse.ArgumentParser:
    """The command's argument parser."""
    top = Parser(
        prog="valve-control",
        description="Local control of a proportional directional control valve: simulate, and study bags.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    top.add_argument("--version", action="version", version=f"valve-control {__version__}")
    commands = top.add_subparsers(dest="task", required=True, metavar="COMMAND")
    simulate.add_commands(commands)
    recordings.add_commands(commands)
    identification.add_commands(commands)
    calibration.add_commands(commands)
    paper.add_commands(commands)
    theorems.add_commands(commands)
    study.add_commands(commands)
    return top


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command; returns the exit status.

    0; 1 if an output failed or an expectation was not met; 2 for bad input.
    """
    # For small matrices BLAS threads that wait for each other take four times as long on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    arguments = parser().parse_args(argv)
    try:
        return int(arguments.run(arguments) or 0)
    except (ParameterError, BagError) as error:
        print(f"valve-control: {error}", file=sys.stderr)
        return 2
    except ModuleNotFoundError as error:
        print(
            f"valve-control: {arguments.task} needs the Python package {error.name} "
            f"(pip install {error.name})",
            file=sys.stderr,
        )
        return 2
    except BrokenPipeError:
        with contextlib.suppress(OSError):
            sys.stdout.close()
        return 1
    except OSError as error:
        print(
            f"valve-control: {error.filename or 'output'} cannot be written: {error.strerror or error}",
            file=sys.stderr,
        )
        return 1
    except KeyboardInterrupt:
        return 130
