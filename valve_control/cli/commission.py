# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `commission`: tests, tunes and verifies a running valve over ROS, and undoes it."""

import argparse
import math
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import interrupts, outputs, priority
from valve_control.cli.common import check_processes, check_search, event, say, write_json, wrote
from valve_control.parameter import ParameterError, defaults, number, word

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from valve_control.design.commissioning.backup import Backup
    from valve_control.design.commissioning.bench import Record
    from valve_control.design.commissioning.plan import Plan
    from valve_control.design.commissioning.sequence import Result
    from valve_control.nodes.commissioning_client import Controller
    from valve_control.parameter import Values

CHATTER = 0.25  # limit of c_u, where none is asked for and gains can be found that keep it
VALVE, REFUSED = "valve.yaml", "refused_{}.yaml"
TUNED, RESULT, REPORT = "tuned.yaml", "commission.json", "report.html"
FAILED = 1  # exit status if the parameters are those from before


def add_commands(commands: Any) -> None:
    """Add commission to the command's sub-commands."""
    commission = commands.add_parser(
        "commission",
        help="test, model, tune and verify a running valve over ROS, within limits",
        description="Commission a running valve, simulated or real: noise at rest, static gain, friction "
        "and dead zone, frequency response, model, gains, verification run. The controller itself keeps "
        "voltage and travel within their limits. Ctrl-C, a fault or a failure lead to 0 V at once and "
        "restore the previous parameters, and activity.",
    )
    commission.add_argument(
        "--node", default="/controller", metavar="NAME", help="full name of the controller node (/controller)"
    )
    group = commission.add_argument_group("limits")
    group.add_argument(
        "--max-voltage", type=float, default=4.0, metavar="V", help="largest voltage in both directions (4 V)"
    )
    group.add_argument(
        "--travel", type=float, default=2.0, metavar="V", help="largest reading in both directions (2 V)"
    )
    group = commission.add_argument_group("tuning")
    group.add_argument("--controller", metavar="LAW", help="law to tune (the present law)")
    group.add_argument(
        "--max-chatter",
        type=float,
        metavar="C_U",
        help=f"limit of the chatter; a limit that you give is kept (default: {CHATTER:g}, or more if no "
        f"gains keep it)",
    )
    group.add_argument(
        "--sensor-delay",
        type=float,
        default=0.0,
        metavar="S",
        help="dead time of the sensor (0 s); the rest of the dead time belongs to the actuator",
    )
    group.add_argument(
        "--alone",
        action="store_true",
        help="tune this law only, and no PID that could have a smaller error",
    )
    group.add_argument("--budget", type=int, default=200, metavar="N", help="number of sets of gains (200)")
    group.add_argument(
        "--valves", type=int, default=6, metavar="N", help="number of valves in the search (6)"
    )
    group.add_argument(
        "--unseen", type=int, default=32, metavar="N", help="number of valves in the verification (32)"
    )
    group.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the search (1)")
    group.add_argument(
        "--threads",
        type=int,
        default=priority.spare_cores(),
        metavar="N",
        help="number of threads (all cores but one)",
    )
    group = commission.add_argument_group("course of the commissioning")
    group.add_argument("--yes", action="store_true", help="do not ask before each step")
    group.add_argument(
        "--resume",
        metavar="FOLDER",
        help="go on after the last whole test of a failed commissioning in FOLDER, which is the --folder too",
    )
    group.add_argument("--undo", action="store_true", help="restore the previous parameters and exit")
    group.add_argument("--activate", action="store_true", help="with --undo: activate the controller too")
    output = commission.add_argument_group("output")
    output.add_argument(
        "--folder",
        default="out/commission",
        help="folder of the previous parameters and the report (out/commission)",
    )
    output.add_argument("--json", metavar="FILE", help="result as JSON; - for standard output alone")
    commission.set_defaults(run=_commission)


def _commission(arguments: argparse.Namespace) -> int:
    _check(arguments)
    from valve_control.design.commissioning.bench import Fault

    if arguments.undo:
        _backup(arguments)  # whether there is one is known without the node
    try:
        from valve_control.nodes.commissioning_client import connected
    except ImportError as error:
        raise ParameterError(f"commission needs ROS 2: {error}") from error
    interrupts.watch(signal.SIGTERM, signal.SIGHUP)
    with connected(arguments.node) as controller:
        try:
            if arguments.undo:
                return _undo(arguments, controller)
            return _run(arguments, controller)
        except Fault as fault:
            print(f"valve-control: {fault}", file=sys.stderr)
            return FAILED


def _check(arguments: argparse.Namespace) -> None:
    from valve_control.design.identification import dead_time

    check_processes("threads", arguments.threads)
    dead_time.check(arguments.sensor_delay)
    check_search(arguments.seed, arguments.valves, arguments.unseen, arguments.budget)
    for name in ("max_voltage", "travel", "max_chatter"):
        value = getattr(arguments, name)
        if value is not None and not 0.0 < value < math.inf:
            raise ParameterError(f"--{name.replace('_', '-')} is {value:g}; it must be above 0, and finite")
    if arguments.activate and not arguments.undo:
        raise ParameterError("--activate goes with --undo; a commissioning activates the controller itself")
    if arguments.resume is not None:
        if arguments.undo:
            raise ParameterError("--resume goes on with a commissioning, and --undo takes it back; give one")
        arguments.folder = arguments.resume
    if not all(part.isidentifier() for part in arguments.node.strip("/").split("/")):
        raise ParameterError(f"--node {arguments.node} is no full name of a node, such as /boom/controller")
    if arguments.controller is not None:
        from valve_control.control.laws.registry import LAWS

        if arguments.controller not in LAWS:
            raise ParameterError(
                f"--controller {arguments.controller}: there is no such law; there are {', '.join(LAWS)}"
            )
    if not arguments.undo and not arguments.yes and not sys.stdin.isatty():
        raise ParameterError("nobody can be asked before each step; --yes commissions without questions")
    if arguments.json not in (None, "-"):
        outputs.check([arguments.json])


def _backup(arguments: argparse.Namespace) -> "Backup":
    """What --folder has of the parameters from before. Raises ParameterError if it has nothing."""
    from valve_control.design.commissioning import backup

    kept = backup.read(Path(arguments.folder))
    if kept is None:
        raise ParameterError(f"there is no commissioning in {arguments.folder}; --folder names another one")
    return kept


def _undo(arguments: argparse.Namespace, controller: "Controller") -> int:
    from valve_control.design.commissioning import backup, sequence

    kept = _backup(arguments)
    if kept.node != controller.name:
        raise ParameterError(
            f"{arguments.folder} has the parameters of {kept.node}, not of {controller.name}; give --node or "
            "--folder"
        )
    count = sequence.restore(controller, kept.values)
    backup.mark(Path(arguments.folder), kept.node, backup.UNDONE)
    say(arguments, f"{count} parameters of {kept.node} set back; all are as before the commissioning")
    if arguments.activate:
        controller.on()
    if not controller.active:
        say(arguments, "the controller is inactive and gives 0 V; --undo --activate lets it work again")
    return 0


def _plan(arguments: argparse.Namespace, law: str) -> "Plan":
    from valve_control.design.commissioning.bench import SafetyLimits
    from valve_control.design.commissioning.plan import Plan

    return Plan(
        limits=SafetyLimits(arguments.max_voltage, arguments.travel),
        law=arguments.controller or law,
        chatter=CHATTER if arguments.max_chatter is None else arguments.max_chatter,
        budget=arguments.budget,
        valves=arguments.valves,
        unseen=arguments.unseen,
        seed=arguments.seed,
        threads=arguments.threads,
        firm=arguments.max_chatter is not None,
        sensor_delay=arguments.sensor_delay,
        alone=arguments.alone,
        gives_way=True,
    )


def _run(arguments: argparse.Namespace, controller: "Controller") -> int:
    from valve_control.design.commissioning import backup, sequence
    from valve_control.design.commissioning.bench import Fault
    from valve_control.design.commissioning.plan import check

    folder = Path(arguments.folder)
    before = controller.values()
    kept = backup.read(folder)
    if kept is not None and kept.node != controller.name and kept.state in (backup.RUNNING, backup.DONE):
        raise ParameterError(
            f"{folder} has the parameters from before the commissioning of {kept.node}; --folder gives "
            f"{controller.name} one of its own"
        )
    if kept is not None and kept.state == backup.RUNNING and backup.differences(before, kept.values):
        raise ParameterError(
            f"a commissioning of {kept.node} was not brought to its end, and {folder} has the parameters "
            "from before it; --undo brings them back"
        )
    plan = _plan(arguments, word(before, "controller"))
    check(plan, before)
    records = {}
    if arguments.resume is not None:
        records = backup.read_tests(folder, controller.name, plan.limits, number(before, "sample_period"))
        say(arguments, f"{folder} has whole tests: {', '.join(sorted(records))}")
    controller.meet_valve()
    refused = sorted(path.name for path in folder.glob(REFUSED.format("*")))
    aside = backup.set_aside(folder, [REPORT, RESULT, TUNED, VALVE, backup.TESTS, *refused])
    if aside is not None:
        say(arguments, f"moved the files of an earlier commissioning to {aside}")
    backup.write(folder, controller.name, before)
    wrote(arguments, folder / backup.PARAMETERS, ": the parameters from before")
    steps = _Steps(
        arguments, lambda records: backup.write_tests(folder, controller.name, plan.limits, records)
    )
    told: list[str] = []
    written: list[Path] = []
    try:
        with sequence.reversible(controller, before, told.append):
            result = sequence.run(controller, plan, before, steps, records=records)
            steps.close()
            for name, text in _texts(arguments, result).items():
                written.append(folder / name)
                outputs.write(str(folder / name), text)
            backup.mark(folder, controller.name, backup.DONE)
    except BaseException as error:
        steps.close()
        backup_safe = sequence.AS_BEFORE in told
        if isinstance(error, Fault) and not backup_safe:
            told.append(f"its parameters from before are in {folder}; --undo brings them back")
        for text in told:
            print(text, file=sys.stderr)
        if backup_safe:
            try:
                for path in written:
                    path.unlink(missing_ok=True)
                backup.mark(folder, controller.name, backup.ABORTED)
            except OSError as failed:
                print(f"{folder} could not be put in order: {failed.strerror or failed}", file=sys.stderr)
        if isinstance(error, (ParameterError, sequence.Refused)):
            print(f"valve-control: {error}", file=sys.stderr)
            return FAILED
        raise
    _tell(arguments, result, written)
    return 0


class _Steps:
    """Asks before each step, shows its progress, and writes what is found on the way."""

    def __init__(
        self, arguments: argparse.Namespace, write: "Callable[[Mapping[str, Record]], None]"
    ) -> None:
        self._arguments = arguments
        self._write = write  # whole tests
        self._tests: dict[str, Any] = {}
        self._bar: Any = None
        self._refusals = 0

    def confirm(self, text: str) -> bool:
        """Whether to go on; the question says what comes next."""
        self.close()
        say(self._arguments, f"next: {text}")
        if self._arguments.yes:
            return True
        print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def progress(self, name: str, done: float, total: float) -> None:
        """Show that ``done`` of ``total`` are over."""
        from tqdm import tqdm

        if self._bar is None or self._bar.desc != f"{name:14}":
            self.close()
            terminal = sys.stderr.isatty()
            self._bar = tqdm(
                total=total,
                desc=f"{name:14}",
                bar_format="{desc} {bar} {n:.0f}/{total:.0f}, {remaining} left",
                ascii=not terminal,
                mininterval=0.2 if terminal else 5.0,
            )
        total = max(total, done)  # a search may end a little after the sets that were planned
        self._bar.total = total
        self._bar.update(done - self._bar.n)
        event(done=done, total=total)

    def tested(self, name: str, record: "Record") -> None:
        """Keep a whole test, after which another commissioning can go on."""
        self._tests[name] = record
        self._write(self._tests)

    def found(self, valve: "Values") -> None:
        """Write the fitted valve, which is worth having whatever becomes of the gains."""
        self._keep(VALVE, "/**/valve_simulator", valve, "The valve as commissioning found it.")

    def refused(self, changes: "Values", reason: str) -> None:
        """Write gains that are not accepted."""
        about = f"Gains that were not accepted: {reason}."
        self._refusals += 1
        self._keep(REFUSED.format(self._refusals), self._arguments.node, changes, about)

    def _keep(self, name: str, node: str, values: "Values", about: str) -> None:
        from tqdm import tqdm

        from valve_control.control.parameters import files

        path = Path(self._arguments.folder) / name
        outputs.write(str(path), files.as_yaml({node: values}, [about]))
        with tqdm.external_write_mode():  # a bar may be shown
            wrote(self._arguments, path)

    def close(self) -> None:
        """End the bar that is shown."""
        if self._bar is not None:
            self._bar.close()
            self._bar = None


def _texts(arguments: argparse.Namespace, result: "Result") -> dict[str, str]:
    """What is written of a commissioning that succeeded, by file."""
    from valve_control.control.parameters import files
    from valve_control.design.commissioning import commissioning_report, sequence

    made = result.verification.measured
    about = [
        "valve-control " + " ".join(arguments.line),
        f"e_rms {made.e_rms:.4g} V and c_u {made.c_u:.3f} in the verification run",
    ]
    return {
        REPORT: commissioning_report.page(result),
        RESULT: outputs.as_json(sequence.as_dict(result)),
        TUNED: files.as_yaml({arguments.node: tuned_values(result.before, result.applied)}, about),
    }


def tuned_values(before: "Values", applied: "Values") -> "Values":
    """What a controller needs beside its defaults to be that ``before`` with the ``applied`` changes."""
    from valve_control.control.parameters.table import CONTROLLER

    final, usual = {**before, **applied}, defaults(CONTROLLER)
    own = (f"{word(final, 'controller')}.", "reshaping.", "linearisation.")
    return {
        name: value
        for name, value in final.items()
        if name in applied
        or name == "controller"
        or (value != usual[name] and (name in ("sample_period", "u_max") or name.startswith(own)))
    }


def _tell(arguments: argparse.Namespace, result: "Result", written: list[Path]) -> None:
    from valve_control.design.commissioning import sequence
    from valve_control.design.tuning import limits

    made = result.verification
    say(
        arguments,
        f"{result.tuned.law}: e_rms {1e3 * made.measured.e_rms:.2f} mV, c_u {made.measured.c_u:.3f} on the "
        f"running valve ({1e3 * made.expected.e_rms:.2f} mV, {made.expected.c_u:.3f} in simulation"
        + (f"; {1e3 * made.former.e_rms:.2f} mV with the parameters from before" if made.former else "")
        + ")",
    )
    for note in (*result.notes, *result.tuned.notes):
        say(arguments, note)
    for line in limits.as_text(result.tuned.limits, f"sets of gains of {result.tuned.law}"):
        say(arguments, line)
    for path in written:
        wrote(arguments, path)
    write_json(arguments, sequence.as_dict(result))
