# SPDX-FileCopyrightText: 2026 valve_control developers
# SPDX-License-Identifier: Apache-2.0
"""Keeps the files of a commissioning: previous parameters, whole tests, results and how it stands.

So the parameters come back whatever happens, and another commissioning can go on after the tests.
"""

import io
import itertools
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from valve_control import outputs
from valve_control.control.parameters import arguments, ros_file
from valve_control.control.parameters.table import CONTROLLER
from valve_control.design.commissioning import commissioning_report, sequence
from valve_control.design.commissioning.bench import Record, SafetyLimits
from valve_control.design.commissioning.sequence import Result
from valve_control.parameter import ParameterError, Values, defaults, word

PARAMETERS, STATE, TESTS = "before.yaml", "state.json", "tests.npz"
VALVE, REFUSED = "valve.yaml", "refused_{}.yaml"
TUNED, RESULT, REPORT = "tuned.yaml", "commission.json", "report.html"
EARLIER = "earlier"  # folder of what earlier commissionings left
RUNNING, DONE, ABORTED, UNDONE = "running", "commissioned", "aborted", "undone"


class Backup(NamedTuple):
    """The previous parameters of one controller, and how its commissioning stands."""

    node: str  # full name
    values: Values
    state: str


class Folder:
    """Files of the commissioning of the controller ``node`` in ``path``, within ``limits``.

    ``wrote`` gets each result.
    """

    def __init__(
        self, path: Path, node: str, limits: SafetyLimits, wrote: Callable[[Path], None] = lambda path: None
    ) -> None:
        self.path, self.node, self.limits = path, node, limits
        self.results: list[Path] = []
        self._wrote = wrote
        self._refusals = 0

    def backup(self) -> Backup | None:
        """The previous parameters, None if there are none. Raises ParameterError for damaged files."""
        path = self.path / STATE
        if not path.exists():
            return None
        try:
            content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
            node, state = str(content["node"]), str(content["state"])
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise ParameterError(f"{path} is damaged: {error}") from error
        return Backup(node, arguments.addressed(str(self.path / PARAMETERS), node, CONTROLLER), state)

    def check(self, present: Values) -> None:
        """Raise ParameterError if the folder has what another commissioning still needs.

        ``present``: parameters of the controller.
        """
        backup = self.backup()
        if backup is not None and backup.node != self.node and backup.state in (RUNNING, DONE):
            raise ParameterError(
                f"{self.path} has the previous parameters of {backup.node}; --folder "
                f"gives {self.node} one of its own"
            )
        if backup is not None and backup.state == RUNNING and sequence.differences(present, backup.values):
            raise ParameterError(
                f"a commissioning of {backup.node} was not brought to its end, and {self.path} has the "
                "previous parameters; --undo restores them"
            )

    def begin(self, before: Values) -> Path | None:
        """Write the parameters ``before``, and that the commissioning runs. Raises OSError.

        What an earlier commissioning has left moves to a folder of its own, which is returned.
        """
        names = [REPORT, RESULT, TUNED, VALVE, TESTS, STATE, PARAMETERS, REFUSED.format("*")]
        left = sorted(path for name in names for path in self.path.glob(name))
        aside = None
        if left:
            places = (self.path / EARLIER / str(number) for number in itertools.count(1))
            aside = next(place for place in places if not place.exists())
            aside.mkdir(parents=True)
            for path in left:
                path.rename(aside / path.name)
        self.path.mkdir(parents=True, exist_ok=True)
        about = "Parameters before the commissioning; --undo restores them."
        self._keep(PARAMETERS, self.node, before, about)
        self.mark(RUNNING)
        return aside

    def mark(self, state: str) -> None:
        """Write how the commissioning stands. Raises OSError."""
        outputs.write(str(self.path / STATE), outputs.as_json({"node": self.node, "state": state}))

    def tested(self, records: sequence.Records) -> None:
        """Write these whole tests. Raises OSError."""
        arrays: dict[str, Any] = {
            f"{test}.{field}": np.asarray(value)
            for test, one in records.items()
            for field, value in one._asdict().items()
        }
        packed = io.BytesIO()
        np.savez_compressed(packed, node=np.array(self.node), limits=np.array(self.limits), **arrays)
        outputs.write(str(self.path / TESTS), packed.getvalue())

    def tests(self, period: float) -> dict[str, Record]:
        """Whole tests by name. Raises ParameterError unless they have the limits and this ``period`` [s]."""
        path = self.path / TESTS
        if not path.exists():
            raise ParameterError(
                f"{self.path} has no whole test of a commissioning; --resume names another folder"
            )
        try:
            with np.load(path) as content:
                node, within = str(content["node"]), SafetyLimits(*map(float, content["limits"]))
                fields: dict[str, dict[str, Any]] = {}
                for name in content.files:
                    test, _, field = name.rpartition(".")
                    fields.setdefault(test, {})[field] = content[name]
                del fields[""]  # node and limits
                for one in fields.values():
                    one.update(period=float(one["period"]), begins=tuple(one["begins"].tolist()))
                records = {test: Record(**one) for test, one in fields.items()}
        except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
            raise ParameterError(f"{path} is damaged: {error}") from error
        periods = {record.period for record in records.values()}
        if (node, within) != (self.node, self.limits) or periods - {period}:
            raise ParameterError(
                f"the tests in {self.path} are of {node} within ±{within.voltage:g} V and "
                f"±{within.travel:g} V of travel; --resume needs the same node, --max-voltage, --travel and "
                "sample_period"
            )
        return records

    def fitted(self, valve: Values) -> None:
        """Write the fitted valve, which is worth having whatever becomes of the gains. Raises OSError."""
        self._keep(VALVE, "/**/valve_simulator", valve, "The valve as commissioning found it.")

    def refused(self, changes: Values, reason: str) -> None:
        """Write gains that are not accepted. Raises OSError."""
        self._refusals += 1
        about = f"Gains that were not accepted: {reason}."
        self._keep(REFUSED.format(self._refusals), self.node, changes, about)

    def _keep(self, name: str, node: str, values: Values, about: str) -> None:
        outputs.write(str(self.path / name), ros_file.as_yaml({node: values}, [about]))
        self._wrote(self.path / name)

    def finish(self, result: Result, command: str) -> None:
        """Write what a successful commissioning leaves; ``command``: what was typed. Raises OSError."""
        measured = result.verification.measured
        about = [
            command,
            f"e_rms {measured.e_rms:.4g} V and c_u {measured.c_u:.3f} in the verification run",
        ]
        texts = {
            REPORT: commissioning_report.page(result),
            RESULT: outputs.as_json(sequence.as_dict(result)),
            TUNED: ros_file.as_yaml({self.node: tuned_values(result.before, result.applied)}, about),
        }
        for name, text in texts.items():
            self.results.append(self.path / name)
            outputs.write(str(self.path / name), text)
        self.mark(DONE)

    def abandon(self) -> None:
        """Remove the results of a commissioning that ended while they were written. Raises OSError."""
        for path in self.results:
            path.unlink(missing_ok=True)
        self.mark(ABORTED)


def tuned_values(before: Values, applied: Values) -> Values:
    """What a controller needs beside its defaults to be that ``before`` with the ``applied`` changes."""
    final, usual = {**before, **applied}, defaults(CONTROLLER)
    kinds = (f"{word(final, 'controller')}.", "reshaping.", "linearisation.")
    return {
        name: value
        for name, value in final.items()
        if name in applied
        or name == "controller"
        or (value != usual[name] and (name in ("sample_period", "u_max") or name.startswith(kinds)))
    }
