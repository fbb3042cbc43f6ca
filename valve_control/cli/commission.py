# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Defines the sub-command `commission`: tests, tunes and verifies a running valve over ROS, and undoes it."""

import argparse
import contextlib
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from valve_control import interrupts
from valve_control.cli import common
from valve_control.design import priority
from valve_control.design.commissioning.bench import Fault, Plan, SafetyLimits, check
from valve_control.parameter import ParameterError, number, word

if TYPE_CHECKING:
    from valve_control.design.commissioning.folder import Folder
    from valve_control.design.commissioning.sequence import Result, Reversal
    from valve_control.nodes.commissioning_client import Controller
    from valve_control.parameter import Values

OF_PLAN = ("budget", "valves", "unseen", "seed", "threads", "sensor_delay")  # options
FAILED = 1  # exit status if the parameters are the previous ones
KEPT = f"limit of the chatter c_u ({common.CHATTER:g}, or more if no gains keep that)"


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
    text = "full name of the controller node (/controller)"
    commission.add_argument("--node", default="/controller", metavar="NAME", help=text)
    common.numbers(
        commission.add_argument_group("limits"),
        ("max-voltage", common.within(0.1, 1e3), 4.0, "V", "largest voltage, up and down (%(default)g V)"),
        ("travel", common.within(0.2, 1e3), 2.0, "V", "largest reading, up and down (%(default)g V)"),
    )
    group = commission.add_argument_group("tuning")
    common.law_option(group, "law to tune (the present law)")
    common.numbers(
        group,
        ("max-chatter", common.within(1e-6, 1e3), None, "RATIO", KEPT),
        ("sensor-delay", common.within(0.0, 1.0), 0.0, "S", "part of the dead time in the sensor (0 s)"),
        ("budget", common.BUDGET, 200, "N", "number of sets of gains (%(default)s)"),
        ("valves", common.VALVES, 6, "N", "number of valves in the search (%(default)s)"),
        ("unseen", common.VALVES, 32, "N", "number of valves in the verification (%(default)s)"),
        common.SEED,
        (*common.THREADS[:2], priority.spare_cores(), "N", "number of threads (all cores but one)"),
    )
    group = commission.add_argument_group("course of the commissioning")
    group.add_argument("--yes", action="store_true", help="do not ask before each step")
    text = "go on after the last whole test of a failed commissioning in FOLDER, which is the --folder too"
    group.add_argument("--resume", metavar="FOLDER", help=text)
    group.add_argument("--undo", action="store_true", help="restore the previous parameters and exit")
    group.add_argument("--activate", action="store_true", help="with --undo: activate the controller too")
    text = "folder of the previous parameters and the report (out/commission)"
    common.output_group(commission).add_argument("--folder", default="out/commission", help=text)
    commission.set_defaults(run=_commission)


def _commission(arguments: argparse.Namespace) -> int:
    _check(arguments)
    if arguments.undo:
        _backup(_folder(arguments))  # whether there is one is known without the node
    try:
        from valve_control.nodes.commissioning_client import connected
    except ImportError as error:
        raise ParameterError(f"commission needs ROS 2: {error}") from error
    interrupts.watch(signal.SIGTERM, signal.SIGHUP)
    with connected(arguments.node) as controller:
        try:
            return (_undo if arguments.undo else _run)(arguments, controller)
        except Fault as fault:
            print(f"valve-control: {fault}", file=sys.stderr)
            return FAILED


def _check(arguments: argparse.Namespace) -> None:
    name, who = ("resume", "with --undo") if arguments.undo else ("activate", "without --undo")
    common.refuse(arguments, [name], f"commission {who}")
    arguments.folder = arguments.resume or arguments.folder
    if not all(part.isidentifier() for part in arguments.node.strip("/").split("/")):
        raise ParameterError(f"--node {arguments.node} is no full name of a node, such as /boom/controller")
    if not arguments.undo and not arguments.yes and not sys.stdin.isatty():
        raise ParameterError("nobody can be asked before each step; --yes commissions without questions")


def _folder(arguments: argparse.Namespace) -> "Folder":
    from valve_control.design.commissioning.folder import Folder

    node, limits = "/" + arguments.node.strip("/"), SafetyLimits(arguments.max_voltage, arguments.travel)
    return Folder(Path(arguments.folder), node, limits, lambda path: common.wrote(arguments, path))


def _backup(folder: "Folder") -> "Values":
    """The previous parameters, which ``folder`` has. Raises ParameterError if it has none of its node."""
    backup = folder.backup()
    if backup is None:
        raise ParameterError(f"there is no commissioning in {folder.path}; --folder names another one")
    if backup.node != folder.node:
        raise ParameterError(
            f"{folder.path} has the parameters of {backup.node}, not of {folder.node}; give --node or "
            "--folder"
        )
    return backup.values


def _undo(arguments: argparse.Namespace, controller: "Controller") -> int:
    from valve_control.design.commissioning import sequence
    from valve_control.design.commissioning.folder import UNDONE

    folder = _folder(arguments)
    count = sequence.restore(controller, _backup(folder))
    folder.mark(UNDONE)
    text = f"{count} parameters of {folder.node} set back; all are as before the commissioning"
    common.say(arguments, text)
    if arguments.activate:
        controller.on()
    if not controller.active:
        text = "the controller is inactive and gives 0 V; --undo --activate lets it work again"
        common.say(arguments, text)
    return 0


def _run(arguments: argparse.Namespace, controller: "Controller") -> int:
    from valve_control.design.commissioning import sequence

    before = controller.values()
    folder = _folder(arguments)
    folder.check(before)
    plan = Plan(
        limits=folder.limits,
        law=arguments.controller or word(before, "controller"),
        chatter=common.CHATTER if arguments.max_chatter is None else arguments.max_chatter,
        firm=arguments.max_chatter is not None,
        gives_way=True,
        **{name: getattr(arguments, name) for name in OF_PLAN},
    )
    check(plan, before)
    records = {}
    if arguments.resume is not None:
        records = folder.tests(number(before, "sample_period"))
        common.say(arguments, f"{folder.path} has whole tests: {', '.join(sorted(records))}")
    controller.meet_valve()
    aside = folder.begin(before)
    if aside is not None:
        common.say(arguments, f"moved the files of an earlier commissioning to {aside}")
    reversal, steps = sequence.Reversal(), _Steps(arguments, folder)
    try:
        with contextlib.closing(steps), sequence.reversible(controller, before, reversal):
            result = sequence.Commissioning(controller, plan, before, steps, records).run()
            folder.finish(result, "valve-control " + " ".join(arguments.line))
    except BaseException as error:
        _report_end(folder, reversal, error)
        if isinstance(error, (ParameterError, sequence.Refused)):
            print(f"valve-control: {error}", file=sys.stderr)
            return FAILED
        raise
    _report(arguments, result, folder)
    return 0


def _report_end(folder: "Folder", reversal: "Reversal", error: BaseException) -> None:
    """Say what became of the parameters at an early end, and put ``folder`` in order."""
    lines = list(reversal.report)
    if not reversal.restored and isinstance(error, Fault):
        lines.append(f"its previous parameters are in {folder.path}; --undo restores them")
    print(*lines, sep="\n", file=sys.stderr)
    if reversal.restored:
        try:
            folder.abandon()
        except OSError as failed:
            print(f"{folder.path} could not be put in order: {failed.strerror or failed}", file=sys.stderr)


class _Steps:
    """Asks before each step, shows its progress, and lets ``folder`` keep results on the way."""

    def __init__(self, arguments: argparse.Namespace, folder: "Folder") -> None:
        self.tested, self.fitted, self.refused = folder.tested, folder.fitted, folder.refused
        self._arguments, self._step, self._bar = arguments, "", common.progress(0, "")

    def confirm(self, text: str) -> bool:
        """Whether to go on; the question says what comes next."""
        common.say(self._arguments, f"next: {text}")
        if self._arguments.yes:
            return True
        print("go on? [y/N] ", end="", file=sys.stderr, flush=True)
        return sys.stdin.readline().strip().lower() in ("y", "yes")

    def progress(self, name: str, done: float, total: float) -> None:
        """Say that the step ``name`` begins, and now and then that ``done`` of ``total`` are over."""
        if name != self._step:
            self.close()
            self._step, self._bar = name, common.progress(round(total), f"({name})")
            print(f"{name} …", file=sys.stderr, flush=True)
        self._bar.update(round(min(done, total)) - self._bar.n)
        if done >= total:
            self.close()

    def close(self) -> None:
        """End the bar of the last step."""
        self._bar.close()


def _report(arguments: argparse.Namespace, result: "Result", folder: "Folder") -> None:
    from valve_control.design.commissioning import sequence
    from valve_control.design.tuning import limits

    verified = result.verification
    before = f"; {1e3 * verified.former.e_rms:.2f} mV with the previous parameters" if verified.former else ""
    common.say(
        arguments,
        f"{result.tuned.law}: e_rms {1e3 * verified.measured.e_rms:.2f} mV, c_u {verified.measured.c_u:.3f} "
        f"on the running valve ({1e3 * verified.expected.e_rms:.2f} mV, {verified.expected.c_u:.3f} in "
        f"simulation{before})",
    )
    table = limits.as_text(result.tuned.limits, f"sets of gains of {result.tuned.law}")
    for line in (*result.notes, *result.tuned.notes, *table):
        common.say(arguments, line)
    for path in folder.results:
        common.wrote(arguments, path)
    common.write_json(arguments, sequence.as_dict(result))
